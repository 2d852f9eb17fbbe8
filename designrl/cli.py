"""The `designrl` command."""

import argparse
import contextlib
import dataclasses
import errno
import importlib
import json
import shlex
import sys
import typing
from pathlib import Path

from designrl.design import changes_in_words
from designrl.errors import InputError, printable, remark
from designrl.experiments import EXPERIMENTS, RECIPES, get_experiment
from designrl.files import file_hash, is_locked, read_limited, require_new
from designrl.numeric import whole_number
from designrl.provenance import VERSION, core_count
from designrl.settings import MAX_EPISODES, TrainSettings, option
from designrl.terminal import heed_signals, open_streams, unsaid

EXIT_INPUT = 2
EXIT_INTERRUPTED, EXIT_PIPE = 130, 141  # as a shell reports what SIGINT or SIGPIPE ended


def load_module(name: str) -> None:
    """Run a module, by its file or its name: it registers experiments of the user's own.

    By name in the end, from the file's folder, so that worker processes find what it defines.

    Raises:
        InputError: there is no such module, or it needs one that is not there.
    """
    path = Path(name)
    folder, module = (path.parent, path.stem) if path.suffix == ".py" else (Path(), name)
    if path.suffix == ".py" and not path.is_file():
        raise InputError(f"{name} is not a file; name a module that registers experiments")
    sys.path.append(str(folder.absolute()))
    try:
        found = importlib.import_module(module)
    except ImportError as error:
        mend = (
            "; name a .py file, or a module that can be imported"
            if module.split(".")[0] == error.name
            else ""
        )
        raise InputError(f"{name} cannot be loaded: {error}{mend}") from None
    source = Path(getattr(found, "__file__", None) or "")
    if path.suffix == ".py" and source.resolve() != path.resolve():
        raise InputError(f"{name} has the name of a module that is in use; give it another")


def _command(commands, name: str, function, help: str) -> argparse.ArgumentParser:  # noqa: A002
    sub = commands.add_parser(name, help=help, description=help[0].upper() + help[1:] + ".")
    sub.set_defaults(function=function)
    return sub


def _workers(sub, group) -> None:
    sub.add_argument("--backend", default="engine", help='"engine" (default) or "reference"')
    group.add_argument(
        "--workers",
        type=int,
        default=core_count(),
        help="processes or threads (default: %(default)s); they do not change the result",
    )


def _agent_file(sub) -> None:
    about = "a checkpoint, a run's folder, one that `designrl checkpoints` lists, or a 2018 .json"
    sub.add_argument("file", metavar="FILE", help=about)
    sub.add_argument("--experiment", help="what a 2018 .json was trained for")
    sub.add_argument("--seed", type=int, default=0, help="of the episodes (default: 0)")


def _load(args):
    """The agent that `_agent_file`'s arguments mean."""
    from designrl.names import find, load

    if find(args.file).suffix == ".json" and not args.experiment:
        raise InputError(f"{args.file} does not say what it was trained for; add --experiment NAME")
    return load(args.file, args.experiment)


def _say_file(path: str | Path, sha256: str | None = None) -> None:
    """Name what was used: a name means another file in another folder or checkout."""
    remark(f"from {Path(path).absolute()}, sha256 {sha256 or file_hash(path)}")


def _named_numbers(sub, flag: str, example: str, help: str) -> None:  # noqa: A002
    """An option that takes several texts as the example; None where it is not given."""

    class Collect(argparse.Action):
        def __call__(self, _parser, args, texts, _flag=None):
            named = getattr(args, self.dest) or {}
            for text in texts:
                name, is_one, number = text.rpartition("=")
                name = name.strip()
                try:
                    value = float(number if is_one else "")
                except ValueError:
                    raise InputError(
                        f"{flag} takes NAME=X, as {example!r}; {text!r} is not that. Put files "
                        f"and names before {flag}"
                    ) from None
                if name in named:
                    raise InputError(f"{flag} has {name!r} twice; give it once")
                named[name] = value
            setattr(args, self.dest, named)

    help += f", as {example!r}; several are allowed"
    sub.add_argument(flag, nargs="+", action=Collect, metavar="NAME=X", help=help)


def _design(sub) -> None:
    about = "change the agent's body, in scales of the original size"
    _named_numbers(sub, "--design", "bottom leg 2 height=0.6", about)


def _reward_weights(sub) -> None:
    _named_numbers(sub, "--reward-weight", "energy=2.0", "multiply a term of the reward")


def _require_suffix(path: str, suffix: str) -> None:
    if Path(path).suffix != suffix:
        raise InputError(f"{path} must end in {suffix}")


def _experiments(_args) -> None:
    print(f"{'experiment':38} paper  network      design  recipe")
    shown = ("population", "rollouts", "generations", "sigma_decay")
    for e in EXPERIMENTS.values():
        size = e.design.size if e.design else 0
        about = f"{e.name:38} {f'({e.letter})':6} {'-'.join(map(str, e.network.sizes)):13} {size:5}"
        paper = TrainSettings.of(e)
        for recipe in ("paper", "ours"):
            settings = TrainSettings.of(e, recipe)
            words = [f"{settings.population} × {settings.rollouts}"]
            words += [f"{settings.generations:,} generations", f"σ × {settings.sigma_decay}"]
            words += [
                option(name, value)[2:]
                for name, value in vars(settings).items()
                if value != getattr(paper, name) and name not in shown
            ]
            print(f"{about:66} {recipe + ':':7}{', '.join(words)}")
            about = ""


def settings_of(args) -> TrainSettings:
    """The settings that the arguments of `designrl train` mean."""
    names = [f.name for f in dataclasses.fields(TrainSettings) if f.name != "experiment"]
    args.reward_weights = args.reward_weight
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    return TrainSettings.of(args.experiment, args.recipe, **given)


def _train(args) -> None:
    settings = settings_of(args)
    out = Path(args.out or f"runs/{settings.experiment}/seed{settings.seed}")
    if not args.dry_run and is_locked(out / ".lock"):
        raise InputError(f"{out} is in use by another run; wait for it, or choose another --out")
    from designrl.train import TrainingRun  # takes seconds, and so much is known by now

    run = TrainingRun(settings, out, args.workers, args.backend, args.resume, args.ray)
    if run.finished:
        done, stop = run.progress.generation, settings.stop_score
        more = "give --generations more than that to go on"
        if done < settings.generations:
            more = f"it has reached the score of {stop:g} at which it was to end"
        print(printable(f"{out} has {done} generations; {more}"))
        return
    if args.dry_run:
        from designrl.plan import dry_run

        dry_run(run)
        return
    if args.resume and not run.progress.generation:
        others = ", ".join(sorted(p.parent.name for p in out.parent.glob("*/state.safetensors")))
        others = f" ({out.parent} has {others})" if others else ""
        remark(f"{out} holds no generations to go on with; this is a new run{others}")
    heed_signals()  # they save, too
    try:
        run.run()
    except KeyboardInterrupt:
        words = [word for word in sys.argv[1:] if word != "--resume"]
        generation = run.progress.generation
        saved = f"saved in {out}" if generation else "nothing to save yet"
        print(file=sys.stderr)
        remark(f"stopped at generation {generation}, {saved}; go on with:")
        remark(f"  designrl {shlex.join(words)} --resume")
        sys.exit(EXIT_INTERRUPTED)
    p = run.progress
    done = (
        f"{out}/best.safetensors: {p.best_score:.1f} at generation {p.best_generation}, "
        f"{p.total_steps:,} environment steps, {p.cpu_seconds / 3600:.2f} core-hours"
    )
    print(printable(done))


def _add_train(commands) -> None:
    about = "train an experiment; settings that are not given are the recipe's"
    train = _command(commands, "train", _train, about)
    about = "one that `designrl experiments` lists"
    train.add_argument("experiment", metavar="EXPERIMENT", help=about)
    train.add_argument(
        "--recipe",
        default="paper",
        help=f"settings to start from: {', '.join(RECIPES)} (default: paper); ours is one for "
        "every seed, plain has the paper's equations as written",
    )
    for setting in dataclasses.fields(TrainSettings):
        if setting.name == "experiment":
            continue
        if setting.name == "reward_weights":
            _reward_weights(train)
            continue
        hint = typing.get_type_hints(TrainSettings)[setting.name]
        kind = next(t for t in (typing.get_args(hint) or (hint,)) if t is not type(None))
        how = {"type": kind, "metavar": "X"}
        if kind is bool:
            how = {"action": argparse.BooleanOptionalAction}
        flag = "--" + setting.name.replace("_", "-")  # without it, the recipe decides
        train.add_argument(flag, default=None, help=setting.metadata["help"], **how)
    where = train.add_mutually_exclusive_group()
    _workers(train, where)
    where.add_argument(
        "--ray",
        metavar="local|ADDRESS",
        help="simulate on a Ray cluster instead: on a new one here, or on that at the address",
    )
    train.add_argument("--out", help="the run's folder (default: runs/EXPERIMENT/seedSEED)")
    train.add_argument(
        "--resume", action="store_true", help="go on with the run that the folder holds, if any"
    )
    train.add_argument(
        "--dry-run",
        action="store_true",
        help="measure for some seconds what the run would take, say so, and start nothing",
    )


@contextlib.contextmanager
def _bar(unit: str, total: int | None = None):
    """A bar on a terminal, as the function that moves it; without tqdm, there is none."""
    try:
        from tqdm import tqdm
    except ImportError:
        yield lambda count: None
        return
    with tqdm(total=total, unit=unit, leave=False, disable=None) as bar:
        yield bar.update


def _evaluate(args) -> None:
    import gymnasium

    from designrl.evaluation import evaluate, worst

    if args.output:
        from designrl.columns import check_target, write_table

        check_target(args.output)
    if args.worst is not None:
        whole_number("--worst", args.worst, 1)
    agent, design, weights = _load(args), args.design, args.reward_weight
    lidar = {"lidar": args.lidar} if args.lidar else {}
    if args.worst:  # it is played again there; what that lacks is said before the evaluation
        gymnasium.make(agent.experiment.env_id, disable_env_checker=True).close()
    with _bar("episode", args.episodes) as progress:
        result = evaluate(
            agent,
            args.episodes,
            args.seed,
            args.workers,
            args.backend,
            progress=progress,
            design=design,
            **({"reward_weights": weights} if weights else {}),
            **lidar,
        )
    lowest = worst(agent, result, args.worst, **lidar) if args.worst else []
    summary = result.summary()
    if args.output:
        write_table(result.table(), args.output)
    if args.json:
        listed = {"worst": [ending._asdict() for ending in lowest]} if args.worst else {}
        print(json.dumps({**summary, **listed}))
        return
    print(
        f"{summary['experiment']}: {summary['mean']:.1f} ± {summary['std']:.1f} over "
        f"{summary['episodes']} episodes (min {summary['min']:.1f}, max {summary['max']:.1f}), "
        f"{summary['steps']:,} steps in {summary['seconds']:.1f} s on the {result.backend}"
        + (f"; not in its own body: {changes_in_words(result.changed)}" if result.changed else "")
        + (f", {option('reward_weights', weights)}" if weights else "")
        + (f", --lidar {args.lidar}" if args.lidar else "")
    )
    _say_file(agent.file, agent.sha256)
    if lowest:
        print(f"{'episode':>7} {'seed':>10} {'score':>7} {'steps':>5}  the lowest scores")
    for e in lowest:
        about = f"{e.ended} at {e.at:.1f} m"
        print(f"{e.episode:7} {e.seed:10} {e.score:7.1f} {e.steps:5}  {about}")


def _add_evaluate(commands) -> None:
    evaluate = _command(
        commands, "evaluate", _evaluate, "score an agent without training-time rewards"
    )
    _agent_file(evaluate)
    evaluate.add_argument("--episodes", type=int, default=100, help="default: 100, as the paper")
    evaluate.add_argument("--json", action="store_true", help="print one JSON object")
    evaluate.add_argument(
        "-o", "--output", metavar="FILE.csv", help="write each episode's score; also .parquet"
    )
    _reward_weights(evaluate)
    evaluate.add_argument(
        "--worst", type=int, metavar="K", help="list the K lowest scores and what ended them"
    )
    _design(evaluate)
    evaluate.add_argument("--lidar", help='of walkers: "v2" (default, the paper\'s) or "v3"')
    _workers(evaluate, evaluate)


def _import(args) -> None:
    from designrl.author import fitting, load_author
    from designrl.checkpoint import save

    require_new(args.output)
    _require_suffix(args.output, ".safetensors")
    agent = load_author(args.file, get_experiment(args.experiment))
    save(agent, args.output)
    others = [name for name in fitting(len(agent.parameters)) if name != args.experiment]
    doubt = "; by its size the file could as well be of " + " or ".join(others) if others else ""
    print(printable(f"{args.output} written, as {args.experiment}{doubt}"))


def _add_import(commands) -> None:
    convert = _command(commands, "import", _import, "convert a 2018 .json of the author's weights")
    convert.add_argument("file", metavar="FILE.json")
    convert.add_argument("--experiment", required=True, help="what it was trained for")
    convert.add_argument("-o", "--output", required=True, metavar="FILE.safetensors")


def _record(args) -> None:
    from designrl.evaluation import episode_seeds, evaluate

    if not (args.output or args.video):
        raise InputError("name what to write: -o FILE.mcap, --video FILE.mp4, or both")
    whole_number("--episode", args.episode, 0, MAX_EPISODES - 1)
    whole_number("--seed", args.seed, 0)
    if args.output:
        require_new(args.output)
        _require_suffix(args.output, ".mcap")
    if args.video:
        from designrl.video import check_target, record_video

        check_target(args.video)
    agent, design = _load(args), args.design
    if args.worst:
        result = evaluate(agent, seed=args.seed, workers=core_count(), design=design)
        args.episode = int(result.scores.argmin())
        print(f"episode {args.episode} has the lowest of {len(result.scores)} scores")
    seed = int(episode_seeds(args.seed, args.episode + 1)[-1])
    if args.output:
        from designrl.recording import record_rollout

        score = record_rollout(agent, args.output, seed, design=design)
        load = (f"--load {shlex.quote(module)} " for module in args.load)
        look = f"designrl {''.join(load)}replay {shlex.quote(args.output)}"
        print(printable(f"{args.output}: one episode, {score:.1f} points; look at it with: {look}"))
    if args.video:
        with _bar("picture") as progress:
            score = record_video(agent, args.video, seed, progress, design)
        print(printable(f"{args.video}: one episode, {score:.1f} points"))
    _say_file(agent.file, agent.sha256)


def _add_record(commands) -> None:
    record = _command(
        commands, "record", _record, "roll out once and record it for Rerun, or as a video"
    )
    _agent_file(record)
    record.add_argument("-o", "--output", metavar="FILE.mcap")
    record.add_argument("--video", metavar="FILE.mp4", help="a film of it; also .gif or .webp")
    _design(record)
    which = record.add_mutually_exclusive_group()
    which.add_argument("--worst", action="store_true", help="of 100, that with the lowest score")
    which.add_argument(
        "--episode",
        type=int,
        default=0,
        metavar="N",
        help="which of the episodes that `designrl evaluate --json` lists, from 0 (default: 0)",
    )


def _replay(args) -> None:
    from designrl.names import find_run

    args.files = [find_run(file) for file in args.files]
    if args.video:
        _film(args)
        return
    for path, suffix in ((args.save, ".rrd"), (args.headless_screenshot, ".png")):
        if path:
            _require_suffix(path, suffix)
    from designrl.viewer import replay
    from designrl.viewer.web import ADDRESS, PORT

    if args.at is not None and not args.headless_screenshot:
        raise InputError("--at chooses what --headless-screenshot shows; add that, too")
    if not args.web and (args.bind or args.port is not None):
        raise InputError("--bind and --port are those of --web; add that, too")
    web = (args.bind or ADDRESS, PORT if args.port is None else args.port) if args.web else None
    replay(args.files, args.save, args.headless_screenshot, args.at, web, _say_file)
    for path in filter(None, (args.save, args.headless_screenshot)):
        print(printable(f"{path} written"))


def _film(args) -> None:
    from designrl.recording import read
    from designrl.video import STAGES, evolution_video

    others = args.save, args.headless_screenshot, args.web or None, args.at, args.bind, args.port
    if len(args.files) > 1 or any(other is not None for other in others):
        raise InputError("--video films one run and does nothing else; name only its folder")
    _say_file(read(args.files[0]).path)
    with _bar("stage", STAGES) as progress:
        evolution_video(args.files[0], args.video, progress=progress)
    print(f"{args.video} written")


def _add_replay(commands) -> None:
    replay = _command(commands, "replay", _replay, "open recordings in Rerun")
    replay.add_argument(
        "files", nargs="+", metavar="FILE.mcap", help="recordings, run folders or names"
    )
    replay.add_argument("--save", metavar="FILE.rrd", help="write a Rerun file, open nothing")
    replay.add_argument("--headless-screenshot", metavar="FILE.png", help="write a picture")
    replay.add_argument(
        "--at",
        type=float,
        metavar="X",
        help="what the picture shows: a run's generation, counted from 0 (default: the last), or s "
        "of a rollout's time (default: its middle)",
    )

    replay.add_argument(
        "--video",
        metavar="FILE.mp4",
        help="film how a run's body and gait came about, open nothing; also .gif or .webp",
    )
    replay.add_argument(
        "--web", action="store_true", help="serve them to browsers, also through ssh, until Ctrl-C"
    )
    replay.add_argument("--bind", metavar="ADDRESS", help="of --web (default: 127.0.0.1)")
    replay.add_argument("--port", type=int, metavar="N", help="of --web (default: 9090)")


def _compare(args) -> None:
    from designrl import compare
    from designrl.columns import SUFFIXES, check_target, write_table

    as_table = Path(args.output or "").suffix in SUFFIXES
    if args.output:
        (check_target if as_table else compare.check_target)(args.output)
    runs = compare.read_runs(args.runs)
    data = compare.curves(runs)
    print("\n".join(map(printable, compare.summary(data).splitlines())))
    for run in runs:
        _say_file(run.path)
    if args.output:
        if as_table:
            write_table(data, args.output)
        else:
            compare.picture(data, args.output, compare.title(runs))
        print(printable(f"{args.output} written"))


def _add_compare(commands) -> None:
    compare = _command(commands, "compare", _compare, "compare how runs learned")
    compare.add_argument("runs", nargs="+", metavar="RUN|NAME", help="folders, recordings or names")
    compare.add_argument(
        "-o",
        "--output",
        metavar="FILE.png",
        help="the curves; also .svg, .pdf, .csv, .parquet",
    )


def _info(args) -> None:
    from designrl.names import find

    inside = (Path(args.file) / name for name in ("best.safetensors", "generations.mcap"))
    for path in [path for path in inside if path.exists()] or [find(args.file)]:
        _describe(path)


def _describe(path: Path) -> None:
    from designrl.checkpoint import MCAP_MAGIC

    if path.suffix == ".mcap" or read_limited(path, 8).startswith(MCAP_MAGIC):
        from designrl.recording import describe
    elif path.suffix == ".json":
        from designrl.author import describe
    else:
        from designrl.checkpoint import describe
    print(describe(path))


def _add_info(commands) -> None:
    info = _command(
        commands, "info", _info, "tell what a checkpoint, a recording or a run's folder holds"
    )
    info.add_argument("file", metavar="FILE")


def _export(args) -> None:
    from designrl.columns import check_target, write_table
    from designrl.recording import read, table

    check_target(args.output)
    recording = read(args.file)
    columns = table(recording, args.episodes)
    write_table(columns, args.output)
    rows = len(next(iter(columns.values())))
    held = set(columns.get("generation", ()))  # of a published run, only some
    of = f", {len(held):,} of the generations {min(held):,} to {max(held):,}" if held else ""
    print(printable(f"{args.output}: {rows:,} rows, {len(columns)} columns{of}"))
    _say_file(recording.path)


def _add_export(commands) -> None:
    export = _command(commands, "export", _export, "write a recording's numbers as a table")
    about = (
        "a recording, or a run's folder or name: by generation learning curve, evaluations and body"
    )
    export.add_argument("file", metavar="FILE", help=about)
    export.add_argument("-o", "--output", required=True, metavar="FILE.csv", help="also .parquet")
    export.add_argument(
        "--episodes", action="store_true", help="of a run, each episode of its evaluations instead"
    )


def _publish(args) -> None:
    try:
        from reproduce.publish import publish
    except ModuleNotFoundError as error:
        raise InputError(
            f"publishing writes into a clone of designrl's repository, set up with `make setup`; "
            f"this is none ({error})"
        ) from None
    print(printable(publish(Path(args.run), args.name)))


def _add_publish(commands) -> None:
    about = "write a run's agent, card and recording into the clone's folders pretrained and logs"
    publish = _command(commands, "publish", _publish, about)
    publish.add_argument("run", metavar="RUN", help="its folder")
    names = '"seedK" (our recipe), "paper-seedK" (the paper\'s) or "blooper-seedK" (other limits)'
    publish.add_argument("--name", required=True, help=names)


def _checkpoints(_args) -> None:
    from designrl.names import our_agents

    for name, about in our_agents().items():
        experiment = get_experiment(name.partition("/")[0])
        beside = "a body of other limits than the paper's"
        if "paper" in about:
            beside = f"the paper's runs {about['paper']}"
        print(
            f"{name:44} ({experiment.letter}) {about['mean']:6.1f} ± {about['std']:5.1f} over "
            f"{about['episodes']} episodes; {beside}"
        )


class Parser(argparse.ArgumentParser):
    """One that says what is wrong in one sentence, and guesses no option from its start."""

    def __init__(self, **how):
        super().__init__(allow_abbrev=False, **how)

    def parse_known_args(self, args=None, namespace=None):
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:  # argparse leaves them to the top, whose help has nothing on a command's
            self.error(f"there is no place for {' '.join(unknown)}")
        return found, unknown

    def error(self, message: str):
        raise InputError(f"{message}; `{self.prog} --help` says what it takes")


def parser() -> Parser:
    """The command line."""
    top = Parser(
        prog="designrl",
        description="Reinforcement Learning for Improving Agent Design (Ha 2018): train, evaluate, "
        "record and replay agents that learn their body together with their policy.",
    )
    top.add_argument(
        "--load",
        action="append",
        default=[],
        metavar="MODULE",
        help="first run a module or .py file that registers experiments of your own",
    )
    top.add_argument("--version", action="version", version=f"designrl {VERSION}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    about = "list the experiments with the paper's settings and ours"
    _command(commands, "experiments", _experiments, about)
    _add_train(commands)
    _add_evaluate(commands)
    _add_import(commands)
    _add_record(commands)
    _add_replay(commands)
    _add_compare(commands)
    _add_export(commands)
    _add_publish(commands)
    _add_info(commands)
    about = "list the published agents and their scores, beside the paper's"
    _command(commands, "checkpoints", _checkpoints, about)
    return top


# Commands whose answer is what they print: it must not be lost in silence.
ANSWERS = _experiments, _evaluate, _compare, _info, _checkpoints


def main(argv: list[str] | None = None) -> None:
    """Run a command; wrong input ends with one sentence and exit code 2."""
    open_streams()
    try:
        args = parser().parse_args(argv)
        for module in args.load:
            load_module(module)
        args.function(args)
        error = unsaid()
        if error and (args.function in ANSWERS or getattr(args, "dry_run", False)):
            if error.errno == errno.EPIPE:  # `designrl ... | head`: the reader has left
                sys.exit(EXIT_PIPE)
            raise InputError(f"the output cannot be written ({error.strerror}); send it elsewhere")
    except InputError as error:
        remark(f"designrl: {error}")
        sys.exit(EXIT_INPUT)
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    except OSError as error:
        if error.errno not in (errno.EACCES, errno.EPERM, errno.ENAMETOOLONG):
            raise
        remark(f"designrl: {error.filename} cannot be used ({error.strerror}); name another place")
        sys.exit(EXIT_INPUT)
