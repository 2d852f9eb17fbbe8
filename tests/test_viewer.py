"""Replay: the layout and the data without a window, and true pictures where there is a driver."""

import errno
import io
import ipaddress
import json
import os
import re
import select
import shutil
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rerun.blueprint as rrb
from PIL import Image
from test_recording import random_agent, write_run

from designrl import viewer
from designrl.bodies import rotate
from designrl.bodies.robot import _quaternion
from designrl.bodies.walker import WalkerBody
from designrl.errors import InputError
from designrl.recording import Generation, RunWriter, read, record_rollout
from designrl.recording.mcap_file import McapFile
from designrl.viewer import executable, layout, web
from designrl.viewer import picture as picture_module
from designrl.viewer.executable import EXECUTABLE, LISTENING, Rerun
from designrl.viewer.layout import COMPARED
from designrl.viewer.picture import NO_DRIVER, NO_DRIVER_MESSAGE


def rerun(*arguments) -> subprocess.CompletedProcess:
    """Run stock Rerun; its messages come back in stdout."""
    return subprocess.run(
        [EXECUTABLE, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=1800,
    )


def stock_picture(recording: Path, folder: Path) -> np.ndarray:
    """What `rerun FILE` shows, with no code of ours: (H, W, 3) uint8."""
    target = folder / f"{recording.stem}.png"
    target.unlink(missing_ok=True)
    options = "--headless", "--screenshot-to", target, "--window-size", "1280x800"
    options += "--port", "auto"  # beside other tests
    output = rerun(recording, *options).stdout
    if not target.exists() and re.search(NO_DRIVER_MESSAGE, output):
        pytest.skip(NO_DRIVER)
    assert target.exists(), output
    return np.array(Image.open(target).convert("RGB").resize((1280, 800)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of a run: its recording and two rollouts."""
    folder = tmp_path_factory.mktemp("seed0")
    write_run(folder / "generations.mcap", range(12))
    for generation_index in (5, 10):
        path = folder / "rollouts" / f"generation{generation_index:05d}.mcap"
        record_rollout(random_agent("biped-morphology"), path, seed=generation_index)
    return folder


@pytest.fixture(scope="module")
def ant(tmp_path_factory):
    path = tmp_path_factory.mktemp("ant") / "ant.mcap"
    record_rollout(random_agent("ant-morphology"), path, seed=0)
    return path


def logged(path: Path) -> dict[str, set[str]]:
    """Entity -> components, of an .rrd file as Rerun's own command prints it."""
    text = rerun("rrd", "print", path).stdout
    found: dict[str, set[str]] = {}
    for entity, columns in re.findall(r"\) - (/.*?) - data columns: \[(.*?)\]", text):
        found.setdefault(entity.replace("\\", ""), set()).update(columns.split())
    return found


def write_empty(path: Path) -> None:
    """A file as another program may have written it: sound, and without a message."""
    file = McapFile(path)
    file.publish()
    file.close()


@pytest.fixture(scope="module")
def empty(tmp_path_factory):
    path = tmp_path_factory.mktemp("empty") / "empty.mcap"
    write_empty(path)
    return path


def script(folder: Path, body: str) -> Path:
    """An executable file that stands for Rerun's."""
    path = folder / "rerun"
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)
    return path


def listening(rerun: Rerun) -> list[tuple[str, int]]:
    """Address and port of each socket at which a process listens."""
    try:
        links = [os.readlink(p) for p in Path(f"/proc/{rerun._process.pid}/fd").iterdir()]
        tables = [Path("/proc/net", name).read_text() for name in ("tcp", "tcp6")]
    except OSError:
        pytest.skip("needs /proc/net")
    found = []
    for row in (line.split() for table in tables for line in table.splitlines()[1:]):
        address, _, port = row[1].partition(":")
        if row[3] == "0A" and f"socket:[{row[9]}]" in links:
            words = [bytes.fromhex(address[i : i + 8])[::-1] for i in range(0, len(address), 8)]
            ip = ipaddress.ip_address(b"".join(words))
            found.append((str(ip), int(port, 16)))
    return found


# --------------------------------------------------------------------- without a window


def test_a_runs_folder_and_a_rollout_are_replayed_together(folder, ant, tmp_path):
    found = [path.stem for path in viewer.find_recordings([folder])]
    assert found == ["generations", "generation00005", "generation00010"]
    viewer.replay([folder, ant], save=tmp_path / "all.rrd")
    entities = logged(tmp_path / "all.rrd")
    for entity in (
        "/generations/population",
        "/generations/evaluation/each",
        "/generations/sigma",
        "/generations/design/leg 1",
        "/generations/figure/mean/hull/top leg 1/bottom leg 1",
        "/generation00005/world/hull/top leg 2/bottom leg 2",
        "/generation00010/world/lidar",
        "/generation00010/reward",
        "/ant/world/torso/front left top/front left middle/front left bottom/cylinder",
    ):
        assert entity in entities, entity
    assert "Scalars:scalars" in entities["/generation00010/joints"]
    assert "Transform3D:quaternion" in entities["/generation00005/world/hull"]
    assert "/ant/world/lidar" not in entities


def test_a_tab_names_experiment_seed_and_generation(folder, ant, tmp_path):
    agent = random_agent("biped")
    agent.metadata |= {"seed": 3, "generation": 25}
    record_rollout(agent, tmp_path / "a.mcap", seed=0)
    record_rollout(agent, tmp_path / "b.mcap", seed=1)
    paths = folder / "generations.mcap", tmp_path / "a.mcap", tmp_path / "b.mcap", ant
    titles = layout.tab_titles([read(path) for path in paths])
    run = f"biped-morphology seed {read(paths[0]).metadata['seed']}"
    named = [run, "biped seed 3, generation 25", "generation 25", "ant-morphology seed 1"]
    assert titles == named
    titles = layout.tab_titles([read(path) for path in (*paths[1:], *paths[1:3])])
    assert titles == 2 * [named[1]] + named[3:] + 2 * [named[1]], "short ones would be alike"


def test_a_plot_says_what_training_changes_of_the_return(folder, monkeypatch):
    recording = read(folder / "generations.mcap")
    found = layout.training_changes(recording)
    assert found == ["a fall costs nothing", "over 300 earns 100 more"]
    for name, settings, words in (
        ("biped-morphology-smaller-leg", {}, ["leg area reward", *found]),
        ("biped", {"shaped_rewards": False}, []),
        ("ant", {}, []),
        (
            "ant",
            {"reward_weights": {"stall": 0.0, "progress": 1.5}},
            ["stall × 0", "progress × 1.5"],
        ),
    ):
        about = {"experiment": name, "settings": json.dumps(settings)}
        monkeypatch.setattr(type(recording), "metadata", about)
        assert layout.training_changes(recording) == words


def test_a_picture_is_of_the_chosen_moment(folder, tmp_path, monkeypatch):
    taken = []
    monkeypatch.setattr(viewer, "take_picture", lambda rrd, *at: taken.append(at) or b"picture")
    rollout = folder / "rollouts" / "generation00010.mcap"
    seconds = read(rollout).seconds
    for i, (path, at, expected) in enumerate(
        (
            (folder, None, ("generation", 11)),
            (folder, 3, ("generation", 3)),
            (rollout, None, ("time", seconds / 2)),
            (rollout, 0.5, ("time", 0.5)),
        )
    ):
        viewer.replay([path], screenshot=tmp_path / f"{i}.png", at=at)
        assert taken[-1] == expected
    for path, at, text in ((folder, 12, "0 to 11 generations"), (rollout, -1, "--at is -1")):
        with pytest.raises(InputError, match=text):
            viewer.replay([path], tmp_path / "x.rrd", tmp_path / "x.png", at=at)
        assert not (tmp_path / "x.rrd").exists()


def test_several_runs_are_drawn_over_each_other(folder, tmp_path):
    write_run(tmp_path / "seed1" / "generations.mcap", range(12))
    viewer.replay([folder, tmp_path / "seed1"], save=tmp_path / "two.rrd")
    entities = logged(tmp_path / "two.rrd")
    for plot in ("evaluation", "population"):
        for i in range(2):
            assert "Scalars:scalars" in entities[f"/{COMPARED}/{plot}/{i}"]
    viewer.replay([folder], save=tmp_path / "one.rrd")
    assert not [entity for entity in logged(tmp_path / "one.rrd") if COMPARED in entity]


def test_files_of_one_name_stay_apart(folder, tmp_path):
    path = folder / "rollouts" / "generation00005.mcap"
    names = viewer.unique_names([path, path, folder / "generations.mcap"])
    assert len(set(names)) == 3 and names[2] == "generations"


def test_many_rollouts_are_thinned_evenly(tmp_path, capsys):
    (tmp_path / "rollouts").mkdir()
    for i in range(20):
        (tmp_path / "rollouts" / f"generation{i:05d}.mcap").touch()
    found = viewer.find_recordings([tmp_path])
    assert len(found) == viewer.MAX_ROLLOUTS
    assert found[0].stem.endswith("00") and found[-1].stem.endswith("19")
    assert "of 20 rollouts" in capsys.readouterr().err


def test_urdf_angles_become_the_right_rotation():
    q = _quaternion(0, np.pi / 2, np.pi / 4)
    assert np.allclose(rotate(q, np.array([0, 0, 1.0])), [np.sqrt(0.5), np.sqrt(0.5), 0])


def test_a_cut_recording_is_replayed_and_a_folder_without_its_torn_file(folder, tmp_path, capsys):
    run = tmp_path / "run"
    shutil.copytree(folder, run)
    cut, torn = run / "generations.mcap", run / "rollouts" / "generation00005.mcap"
    os.truncate(cut, int(cut.stat().st_size * 0.9))
    torn.write_bytes(b"torn")
    viewer.replay([run], save=tmp_path / "run.rrd")
    errors = capsys.readouterr().err
    assert f"{cut} is not whole" in errors and f"not shown: {torn}" in errors
    assert "/generations/figure/mean/hull" in logged(tmp_path / "run.rrd")
    with pytest.raises(InputError, match="generation00005"):
        viewer.replay([run, torn], save=tmp_path / "both.rrd")
    for path in run.rglob("*.mcap"):
        path.write_bytes(b"torn")
    with pytest.raises(InputError, match="is not an MCAP file"):
        viewer.replay([run], save=tmp_path / "none.rrd")


def test_a_recording_with_nothing_left_says_why(folder, tmp_path, capfd):
    data = (folder / "rollouts" / "generation00005.mcap").read_bytes()
    path = tmp_path / "cut.mcap"
    for size in (60, 2000):  # without any record; with some about the rollout
        path.write_bytes(data[:size])
        with pytest.raises(InputError, match=r"cut\.mcap holds nothing to show \(the file ends in"):
            viewer.replay([path], save=tmp_path / "cut.rrd")
    assert "WARN" not in capfd.readouterr().err


@pytest.mark.parametrize("robot", ["<robot", "<robot/>", "<robot><link><visual/></link></robot>"])
def test_a_damaged_robot_is_one_sentence(robot, tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(WalkerBody, "urdf", lambda *_: robot)
    record_rollout(random_agent("biped"), tmp_path / "a.mcap", seed=0)
    with pytest.raises(InputError, match=r"a\.mcap lacks some of what a rollout holds"):
        viewer.replay([tmp_path / "a.mcap"], save=tmp_path / "a.rrd")
    assert capfd.readouterr().err == ""  # nor does Rerun speak of what it drops


def test_a_viewer_that_does_not_start_is_said_with_what_to_do(folder, tmp_path, monkeypatch):
    rerun = script(tmp_path, "echo a warning; echo it is broken at /its/source.rs:7; exit 1")
    monkeypatch.setattr(executable, "EXECUTABLE", rerun)
    with pytest.raises(InputError, match=r"did not start \(it is broken\); .* add --web, --save"):
        viewer.replay([folder / "generations.mcap"])


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window needs no display")
@pytest.mark.parametrize(
    "displays", [{}, {"DISPLAY": ":98765"}, {"DISPLAY": "x:y"}, {"WAYLAND_DISPLAY": "gone"}]
)
def test_without_a_display_rerun_ends_and_is_quoted(displays, folder, tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    for name, value in ({"XDG_RUNTIME_DIR": str(tmp_path)} | displays).items():
        monkeypatch.setenv(name, value)
    with pytest.raises(InputError, match=r"did not start \(.*\); where there is no display, add"):
        viewer.replay([folder / "generations.mcap"])


def test_a_window_gets_its_recording_by_its_input_and_binds_here(folder, tmp_path, monkeypatch):
    keep = 'echo "$CI" "$@" > "$0.words"; cat > "$0.rrd"'
    rerun = script(tmp_path, keep)
    monkeypatch.setattr(executable, "EXECUTABLE", rerun)
    viewer.replay([folder / "generations.mcap"])
    words = Path(f"{rerun}.words").read_text()
    assert words == "true --bind 127.0.0.1 --port 0 -\n"
    assert "/generations/sigma" in logged(Path(f"{rerun}.rrd"))


def test_a_window_opens_beside_a_stranger_who_holds_reruns_port(folder, monkeypatch):
    if not shutil.which("Xvfb"):
        pytest.skip("needs Xvfb")
    made = []

    class Kept(Rerun):
        def __init__(self, *arguments, **kwargs):
            super().__init__(*arguments, **kwargs)
            made.append(self)

    monkeypatch.setattr(viewer, "Rerun", Kept)
    command = ["Xvfb", "-displayfd", "1", "-nolisten", "tcp"]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as x11,
        socket.socket() as stranger,
    ):
        try:
            monkeypatch.setenv("DISPLAY", f":{int(x11.stdout.readline())}")
            monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
            stranger.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                stranger.bind(("127.0.0.1", 9876))
            except OSError:
                pytest.skip("port 9876 is in use")
            stranger.listen()
            viewer.replay([folder / "generations.mcap"])
            with made[0] as rerun:  # which ends it
                if rerun.says(NO_DRIVER_MESSAGE):
                    pytest.skip(NO_DRIVER)
                assert rerun.viewer().get_state().recordings
                assert {address for address, _ in listening(rerun)} == {"127.0.0.1"}
            assert not select.select([stranger], [], [], 0)[0]
        finally:
            x11.terminate()


@pytest.mark.parametrize("options", [["--serve-web", "--web-viewer-port", "0"], ["--headless"]])
def test_what_we_start_of_rerun_listens_here_alone_and_reports_nothing(
    options, tmp_path, monkeypatch
):
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("CI", "XDG_CONFIG_HOME", "XDG_DATA_HOME"):
        monkeypatch.delenv(name, raising=False)
    with Rerun(*options) as rerun:
        rerun.wait_for(lambda: rerun.says(LISTENING))
        assert {address for address, _ in listening(rerun)} == {"127.0.0.1"}
    assert not [*tmp_path.rglob("analytics*")]


def test_what_we_start_of_rerun_ends_with_a_kill_of_us():
    code = (
        "from designrl.viewer.executable import LISTENING, Rerun\n"
        "with Rerun('--serve-web', '--web-viewer-port', '0') as rerun:\n"
        "    print(rerun.wait_for(lambda: rerun.says(LISTENING)), flush=True)\n"
        "    input()\n"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", code], text=True, **pipes) as process:
        host, port = process.stdout.readline().strip().split(":")
        with socket.create_connection((host, int(port)), 60) as connection:
            process.kill()
            with suppress(ConnectionResetError):  # an end, too
                while connection.recv(100):
                    pass


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda path: None, "name a file"),
        (Path.mkdir, "no recordings"),
        (lambda path: path.write_bytes(b"nonsense"), "is not an MCAP file"),
        (write_empty, "holds nothing to show"),
    ],
)
def test_what_cannot_be_opened_is_named(make, problem, tmp_path):
    make(tmp_path / "x.mcap")
    with pytest.raises(InputError, match=f"x.mcap.*{problem}"):
        viewer.replay([tmp_path / "x.mcap"], save=tmp_path / "x.rrd")


def test_a_place_that_cannot_be_written_is_named(folder, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        viewer.replay([folder / "generations.mcap"], save=folder / "generations.mcap" / "x.rrd")


@pytest.mark.parametrize("option", ["save", "screenshot"])
def test_what_exists_is_never_written_over(option, folder, tmp_path):
    source, other = folder / "generations.mcap", tmp_path / "other"
    other.write_bytes(b"precious")
    before = source.read_bytes()
    for target, text in ((source, "is what is to be replayed"), (other, "exists already; remove")):
        with pytest.raises(InputError, match=text):
            viewer.replay([source], **{option: target})
    with pytest.raises(InputError, match="is what is to be replayed"):
        viewer.replay([folder], **{option: folder / ".." / folder.name})
    with pytest.raises(InputError, match="cannot be both"):
        viewer.replay([source], save=tmp_path / "x", screenshot=tmp_path / "x")
    assert source.read_bytes() == before and other.read_bytes() == b"precious"


@pytest.mark.parametrize("option", ["save", "screenshot"])
def test_a_full_disk_is_one_sentence_and_leaves_nothing(option, folder, tmp_path, monkeypatch):
    write = os.write

    def full(descriptor, data):
        if str(tmp_path / "full") not in os.readlink(f"/proc/self/fd/{descriptor}"):
            return write(descriptor, data)
        if os.fstat(descriptor).st_size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(descriptor, bytes(data[:100]))

    monkeypatch.setattr(os, "write", full)
    monkeypatch.setattr(viewer, "take_picture", lambda rrd, *at: rrd)
    target = tmp_path / "full" / "x"
    with pytest.raises(InputError, match=r"x cannot be written \(No space left on device\)"):
        viewer.replay([folder / "generations.mcap"], **{option: target})
    assert list(target.parent.iterdir()) == []


def test_a_tab_on_another_timeline_than_the_first_says_so(folder):
    run, *rollouts = map(read, viewer.find_recordings([folder]))
    for order, hint in (([run, *rollouts], "rollout"), ([*rollouts, run], "run")):
        tabs = layout.blueprint(order, ["a", "b", "c"]).root_container.contents
        for tab, recording in zip(tabs, order, strict=True):
            first_view = tab
            while isinstance(first_view, rrb.Container):
                first_view = first_view.contents[0]
            assert (layout.HINTS[hint] in first_view.name) == (recording.kind == hint)


@pytest.fixture(scope="module")
def printed(folder, tmp_path_factory):
    """What Rerun finds in the data of a run and its rollouts."""
    path = tmp_path_factory.mktemp("printed") / "a.rrd"
    viewer.replay([folder], save=path)
    return rerun("rrd", "print", "-vvv", path).stdout


def test_beside_a_run_a_rollouts_body_stands_from_the_first_generation_on(printed):
    poses = [chunk for chunk in printed.split("Chunk(") if "entity_path: /generation00010" in chunk]
    poses = [chunk for chunk in poses if "Transform3D:quaternion" in chunk]
    assert len(poses) == 5  # hull and legs
    for chunk in poses:
        assert "index_name: generation" in chunk and re.search(r"row_\w+ +┆ 0 ", chunk)


# ------------------------------------------------------------------------- in a browser


@pytest.fixture
def served(folder):
    """The address that `designrl replay --web` prints."""
    command = [sys.executable, "-m", "designrl", "replay", folder, "--web", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process.stdout.readline().removeprefix("open ").strip()
        finally:
            process.terminate()
    assert process.returncode == 130


def test_a_browser_gets_a_page_and_the_data_of_one_port(served, folder, tmp_path):
    port = int(re.fullmatch(r"http://127\.0\.0\.1:(\d+)/", served)[1])
    with urllib.request.urlopen(served) as answer:
        assert b"<canvas" in answer.read()
        assert answer.url == f"{served}?url=http%3A%2F%2F127.0.0.1%3A{port}%2Freplay.rrd"
        assert answer.headers["Content-Security-Policy"].startswith("default-src 'self' ")
    with urllib.request.urlopen(f"{served}replay.rrd") as answer:
        (tmp_path / "served.rrd").write_bytes(answer.read())
        assert "Access-Control-Allow-Origin" not in answer.headers
    assert "/generations/sigma" in logged(tmp_path / "served.rrd")
    with pytest.raises(InputError, match=rf"{port} cannot be listened at .*--port"):
        viewer.replay([folder], web=("127.0.0.1", port))


def test_a_page_of_another_name_gets_nothing(served):
    here = socket.gethostname()
    for host in ("127.0.0.1:80", "localhost", "[::1]:9090", "192.168.1.2:9090", f"{here}:9090"):
        assert web.is_ours(host)
    for host in ("evil.example", f"{here}.evil.example", "127.0.0.1.evil.example", "", "[", "a@:"):
        assert not web.is_ours(host)
        for path in ("", "replay.rrd"):
            request = urllib.request.Request(served + path, headers={"Host": host})
            with pytest.raises(urllib.error.HTTPError, match="403"):
                urllib.request.urlopen(request)


def test_the_layout_is_in_the_data_and_active(printed):
    assert "BlueprintActivationCommand" in printed and "make_active: true" in printed
    assert "score of evaluated agents, points" in printed


def test_a_browser_shows_our_layout(served):
    reason = "needs playwright (pip) and a chromium in the PATH"
    playwright = pytest.importorskip("playwright.sync_api", reason=reason)
    if not (chromium := shutil.which("chromium")):
        pytest.skip(reason)
    software = "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=software.split())
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.set_default_timeout(1_800_000)
        page.goto(served)

        def sky() -> float:
            page.wait_for_timeout(2000)
            picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
            return _share(np.array(picture), (210, 210, 250), (220, 220, 255))

        assert any(sky() > 10 for _ in range(30))  # behind the body; only our layout has it
        browser.close()


# ------------------------------------------------------------------------- stock Rerun


def test_rerun_finds_nothing_to_say(folder, ant):
    for path in (folder / "generations.mcap", folder / "rollouts" / "generation00005.mcap", ant):
        for options in ([], ["--full"]):
            done = rerun("mcap", "check", *options, path)
            assert done.returncode == 0, done.stdout
            rows = map(str.split, done.stdout.splitlines())
            topics = [row for row in rows if len(row) > 3 and row[3].startswith("/")]
            assert len(topics) == len(read(path).topics)
            assert all(row[0] == "ok" and row[-1] == "—" for row in topics), done.stdout


def _share(picture: np.ndarray, low, high) -> float:
    """Share of the pixels between two colors (3,), in %."""
    return 100 * ((picture >= low) & (picture <= high)).all(axis=2).mean()


def test_stock_rerun_opens_a_run_on_its_body_and_evaluations(folder, empty, tmp_path):
    def drawn(recording: Path) -> bool:
        red, green, blue = np.moveaxis(stock_picture(recording, tmp_path).astype(int), 2, 0)
        legs = (red > green + 40) & (blue > green + 20)  # pink
        levels = (green > red + 60) & (green > blue + 20)  # "INFO" of each line
        return legs.mean() > 1e-4 and levels.mean() > 1e-5

    assert any(drawn(folder / "generations.mcap") for _ in range(3))
    assert not drawn(empty)


@pytest.mark.parametrize("kind", ["walker", "ant"])
def test_stock_rerun_draws_the_body_on_its_ground(kind, folder, ant, empty, tmp_path):
    source = ant if kind == "ant" else folder / "rollouts" / "generation00010.mcap"
    colors = [((60, 110, 50), (130, 200, 120), 0.2)]  # the ground
    if kind == "walker":
        colors.append(((60, 30, 120), (170, 120, 255), 0.1))  # the hull; the viewer shades it

    def drawn(recording: Path) -> bool:
        picture = stock_picture(recording, tmp_path)
        return all(_share(picture, low, high) > share for low, high, share in colors)

    # A busy machine's viewer may take its picture before it has drawn everything.
    assert any(drawn(source) for _ in range(3))
    assert not drawn(empty)


def test_a_picture_is_taken_when_it_has_stopped_changing(monkeypatch):
    pictures = iter([b"notice", b"notice", b"fading", b"still", b"still", b"later"])

    class Viewer:
        def take_screenshot(self):
            return next(pictures)

    clock = iter([0.0, 1.0, 2.0, 7.0, 8.0, 9.0])
    time = SimpleNamespace(monotonic=lambda: next(clock), sleep=lambda seconds: None)
    monkeypatch.setattr(picture_module, "time", time)
    assert picture_module._still_picture(Viewer()) == b"still"


def test_a_viewer_that_has_not_read_the_data_yet_is_asked_again(monkeypatch):
    answers = iter([ConnectionError("no timelines yet"), None])

    class Viewer:
        def set_time(self, timeline, **place):
            if error := next(answers):
                raise error

    time = SimpleNamespace(monotonic=lambda: 0.0, sleep=lambda seconds: None)
    monkeypatch.setattr(picture_module, "time", time)
    picture_module._go_to(Viewer(), "generation", {"sequence": 3})
    assert next(answers, "all asked") == "all asked"


def test_a_picture_shows_body_ground_and_plots(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(picture_module, "NOTICES_SECONDS", 1.5)
    target = tmp_path / "picture.png"
    try:
        viewer.replay([folder / "rollouts" / "generation00010.mcap"], screenshot=target)
    except InputError as error:
        if str(error) != NO_DRIVER:
            raise
        pytest.skip(NO_DRIVER)
    picture = np.array(Image.open(target).convert("RGB"))
    assert picture.shape == (964, 1600, 3) and (picture[:3] > 20).any()  # no empty bar
    assert _share(picture, (100, 170, 85), (125, 195, 110)) > 0.8  # the ground's top
    assert _share(picture, (50, 90, 40), (90, 140, 80)) > 5  # its darker front
    assert _share(picture, (90, 55, 140), (180, 130, 255)) > 0.3  # hull
    assert _share(picture, (200, 200, 240), (230, 230, 255)) > 20  # sky
    assert _share(picture[650:], (70, 160, 210), (100, 200, 250)) > 0.02  # the first lines' blue


@pytest.mark.parametrize("settings", ['{"seed": 1', "[1]", "[" * 100_000])
def test_a_run_whose_settings_are_damaged_is_shown_without_them(settings, tmp_path):
    numbers = np.zeros(2812), np.ones(2812), *(np.ones((2, 1), int) for _ in range(3))
    about = {"experiment": "biped-morphology", "settings": settings}
    with RunWriter(tmp_path / "g.mcap", about) as writer:
        writer.generation(Generation(0, *numbers, 2, 1.0))
    viewer.replay([tmp_path / "g.mcap"], save=tmp_path / "g.rrd")
    assert (tmp_path / "g.rrd").stat().st_size > 1000


@pytest.mark.parametrize("weights", ["[1]", '{"energy": "x"}', "5"])
def test_settings_of_another_program_are_one_sentence(weights, tmp_path):
    about = {"experiment": "biped", "settings": f'{{"reward_weights": {weights}}}'}
    numbers = np.zeros(2804), np.ones(2804), *(np.ones((2, 1), int) for _ in range(3))
    for name in "ab":
        with RunWriter(tmp_path / f"{name}.mcap", about) as writer:
            writer.generation(Generation(0, *numbers, 2, 1.0))
    with pytest.raises(InputError, match=r"a\.mcap lacks some of what a run holds"):
        viewer.replay([tmp_path / "a.mcap", tmp_path / "b.mcap"], save=tmp_path / "g.rrd")
