"""Builds the compiled engine and packs the published agents; all else is in pyproject.toml.

The engine is optional: without a C++ compiler the installation goes on, and training uses the
reference environments.
"""

import os
import platform
import runpy
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from setuptools import Extension, find_namespace_packages, setup
from setuptools.command.build_ext import build_ext

SOURCES = Path("designrl/engine/native")
# Each task once for each instruction set; the best one that a processor has is chosen at run time,
# so one wheel serves every x86-64. Elsewhere there is the portable one alone.
ALL_KINDS = sys.platform.startswith("linux") and platform.machine().lower() in ("x86_64", "amd64")
INSTRUCTION_SETS = {"portable": ["-DENGINE_PORTABLE"]}
if ALL_KINDS:
    avx512 = ["-mavx512f", "-mavx512dq", "-mavx512bw", "-mavx512vl", "-mprefer-vector-width=512"]
    INSTRUCTION_SETS |= {"sse2": [], "avx2": ["-mavx2", "-mfma"], "avx512": avx512}
INTERFACE = [str(SOURCES / "api.cpp")]
TASKS = sorted(str(path) for path in SOURCES.glob("*/*.cpp"))
FLAGS = [
    "-std=c++17",
    "-O3",
    "-g0",
    # Whatever CFLAGS says: the baseline runs anywhere, and the bits must be the reference's, with
    # no product fused into a sum but where the code says so, and without reordered sums.
    *(["-march=x86-64", "-DENGINE_ALL_KINDS"] if ALL_KINDS else ["-DENGINE_PORTABLE"]),
    "-fno-fast-math",
    "-ffp-contract=off",
    # An engine whose sources have changed since is not used.
    f'-DENGINE_SOURCES="{runpy.run_path("designrl/provenance.py")["engine_hash"]()}"',
    # These give up errno and floating-point traps only, and let comparisons become selects.
    "-fno-math-errno",
    "-fno-trapping-math",
]


class BuildEngine(build_ext):
    def build_extension(self, extension):
        print("designrl: compiling the engine (about a minute, once)", flush=True)
        try:
            units = [(source, "baseline", []) for source in INTERFACE]
            units += [
                (source, name, flags)
                for source in TASKS
                for name, flags in INSTRUCTION_SETS.items()
            ]
            with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
                objects = sum(pool.map(self.compile_unit, units), [])
            target = self.get_ext_fullpath(extension.name)
            Path(target).parent.mkdir(parents=True, exist_ok=True)
            self.compiler.link_shared_object(objects, target, target_lang="c++")
        except Exception as error:  # a missing engine must not stop the installation
            print(
                f"designrl: the engine was not built ({error}); training will use the slower "
                "reference environments, with the same results",
                file=sys.stderr,
                flush=True,
            )

    def compile_unit(self, unit):
        source, folder, flags = unit
        return self.compiler.compile(
            [source],
            output_dir=str(Path(self.build_temp) / folder),
            include_dirs=[str(SOURCES)],
            extra_postargs=FLAGS + flags,
        )


setup(
    # The agents go where `designrl.names` looks for them; in a clone they stay where they are.
    packages=[*find_namespace_packages(include=["designrl*"]), "designrl.pretrained"],
    package_dir={"designrl.pretrained": "pretrained"},
    ext_modules=[
        Extension(
            "designrl.engine._native",
            sources=INTERFACE + TASKS,
            depends=sorted(str(path) for path in SOURCES.rglob("*.h")),
            language="c++",
            optional=True,
        )
    ],
    cmdclass={"build_ext": BuildEngine},
)
