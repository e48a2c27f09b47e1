"""The commands of `guidefield` with their options, and errors as exit codes.

Exit codes: 0 for a plan or an answer, 1 if the reply is an honest "no", 2 for an error. Docstrings and help texts are
what `--help` prints; names of commands and options are an interface.
"""

from __future__ import annotations

import enum
import inspect
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import msgspec
import typer
from rich.console import Console
from rich.markup import escape
from rich.text import Text
from typer.core import TyperCommand, TyperGroup

from guidefield.cli.certifying import (
    judging_engine,
    make_certify_request,
    make_executed_request,
    make_robot_reference,
    read_scene_file,
    replay_proofs,
    run_referee,
    split_xacro_arguments,
)
from guidefield.cli.executing import execute
from guidefield.cli.found_run import (
    Data,
    Service,
    fetch_files,
    recording_file,
    require_proof_file,
    require_recording_file,
    require_writable,
)
from guidefield.cli.kept_runs import replay, runs_app
from guidefield.cli.tables import motion_table, robot_table, robots_table
from guidefield.endpoint.link import DEFAULT_LISTEN, Distribution, RosSettings
from guidefield.errors import GuidefieldError, MalformedRequest, Status
from guidefield.first_start import CannotStart, compile_kernels
from guidefield.messages import codec, requests
from guidefield.messages.faults import list_choices
from guidefield.messages.identities import DEFAULT_QUOTAS
from guidefield.messages.replies import CertifyReply, MotionReply, PlanReply, RobotReply, RobotsReply
from guidefield.messages.streams import DEFAULT_STREAMS
from guidefield.messages.values import Reply
from guidefield.parallel import usable_processors
from guidefield.pool.pool import DEFAULT_MEMORY
from guidefield.stores.files import default_data_folder
from guidefield.stores.runs import Retention
from guidefield.viewer import CannotShow, find_viewer, is_listening

if TYPE_CHECKING:
    from guidefield.client import Client
    from guidefield.doctor import Finding

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)

scenes_app = typer.Typer(help="Read scenes from files and store them at a service.", no_args_is_help=True)

WIDTH_OF_ALL_COLUMNS = 150  # width of a terminal from which listed robots have groups and sources, too [characters]

out = Console()
err = Console(stderr=True)


def _complete_robot(begun: str) -> list[str]:
    """List the robots whose names a shell may complete to."""
    from guidefield.robot.library import entries

    return [name for name in entries() if name.startswith(begun)]


def _complete_scene(begun: str) -> list[str]:
    """List the scenes whose names a shell may complete to."""
    from guidefield.stores.scenes import list_packaged

    return [name for name in list_packaged() if name.startswith(begun)]


def _complete_subject(begun: str) -> list[str]:
    """List the pages and messages whose names a shell may complete to."""
    from guidefield.cli.documentation import list_subjects
    from guidefield.messages.schemas import make_schemas

    return [name for name in (*list_subjects(), *make_schemas()["$defs"]) if name.startswith(begun)]


RequestFile = Annotated[Path, typer.Argument(help="JSON file with a request; - reads standard input.", allow_dash=True)]
Connect = Annotated[
    list[str] | None, typer.Option(help=f"Where a service listens, may be repeated; else {DEFAULT_LISTEN}.")
]
ServiceName = Annotated[
    str | None, typer.Option(help="Name of the service; else the one with the least to do is asked.")
]
ClientConfig = Annotated[Path | None, typer.Option(help="Zenoh configuration file (certificates, user).")]
User = Annotated[str | None, typer.Option(help="Ask on the keys of this user; else what the file says.")]
ProofFile = Annotated[
    Path | None, typer.Option(help="Write a proof that the motion is free to this .npz.", callback=require_proof_file)
]
ObjectiveOption = Annotated[
    requests.Objective | None, typer.Option(help="What the motion is optimised for, in place of the request's.")
]
SceneOption = Annotated[
    str | None,
    typer.Option(
        help="A scene, by its name or by a file of any kind, in place of the request's.", autocompletion=_complete_scene
    ),
]
Scale = Annotated[float, typer.Option(help="Factor of the lengths in the scene's file: 0.001 for millimetres.")]
Radius = Annotated[
    float | None, typer.Option(help="Radius of the balls about the points of a scene that is a cloud, in metres.")
]
PackageFolders = Annotated[
    list[Path] | None,
    typer.Option("--package-dir", help="A folder that holds packages or models that a file names; can be repeated."),
]
XacroArguments = Annotated[
    list[str] | None, typer.Option("--xacro-arg", help="name:=value, an argument of a .xacro file; can be repeated.")
]
Show = Annotated[bool, typer.Option("--show", help="Show runs in Rerun's viewer while they go on.")]
Viewer = Annotated[
    str | None,
    typer.Option(help="Show them in the viewer at this address, rerun+http://HOST:PORT/proxy; else in one here."),
]
ReplyFile = Annotated[
    Path | None,
    typer.Option("--output", "-o", help="Write the whole reply to this file, as JSON.", callback=require_writable),
]


def main() -> None:
    """Run the command line; what is wrong with a request, a service or a file becomes one line and exit code 2."""
    try:
        app()
    except (GuidefieldError, CannotShow, CannotStart, OSError) as error:
        err.print(f"[red]{_name(error)}[/red]: {escape(_describe(error))}", highlight=False, soft_wrap=True)
        sys.exit(2)


def _tell_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"guidefield {version('guidefield')}")
        raise typer.Exit


@app.callback()
def options(
    _version: Annotated[
        bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Tell the version and exit.")
    ] = False,
) -> None:
    """Motion planning and kinematics for any URDF robot, certified, over Zenoh, with a recording of every run.

    Begin with `guidefield docs quickstart`.
    """


@app.command()
def plan(
    request: RequestFile,
    output: ReplyFile = None,
    record: Annotated[
        Path | None, typer.Option(help="Write a recording of the run to this .rrd.", callback=require_recording_file)
    ] = None,
    proof: ProofFile = None,
    objective: ObjectiveOption = None,
    scene: SceneOption = None,
    scale: Scale = 1.0,
    radius: Radius = None,
    show: Show = False,
    viewer: Viewer = None,
) -> None:
    """Plan in this process, without a service.

    An example of a request: {"robot": "panda", "scene": "bookshelf", "goal": {"type": "guide_plane"}}. Requests for
    kinematics, clearance and the potential are answered too.

    Exit code 0 for a plan or an answer, 1 if the reply says that there is no plan, 2 for an error.
    """
    from guidefield.engine import Engine, answer

    message = _set_objective(_read_request(request, _read_scene(scene, scale, radius)), objective)
    compile_kernels(err.print, wholly=False)
    address = _choose_viewer(viewer, show=show)
    answer_here = answer if address is None else Engine(viewer=address).answer
    _report(answer_here(message, record_to=record, proof_to=proof), output)


@app.command()
def certify(
    motion: Annotated[str, typer.Argument(help="A motion: .csv, .json, .npz, a run's .rrd, or the id of a kept run.")],
    robot: Annotated[
        str | None,
        typer.Option(
            help="A robot, by its name or by its .urdf, .xacro or .xml (MJCF) file.", autocompletion=_complete_robot
        ),
    ] = None,
    scene: SceneOption = None,
    scale: Scale = 1.0,
    radius: Radius = None,
    srdf: Annotated[Path | None, typer.Option(help="The SRDF of a robot file.")] = None,
    package_dir: PackageFolders = None,
    xacro_arg: XacroArguments = None,
    time_step: Annotated[
        float | None, typer.Option(help="Time from row to row if the file has no times, in seconds.")
    ] = None,
    interpolation: Annotated[
        str | None, typer.Option(help="Which curve goes through samples: spline, or linear.")
    ] = None,
    execution: Annotated[
        str | None,
        typer.Option(
            help="Judge what a controller draws of it: linear, cubic, quintic, first_order_hold, zero_order_hold."
        ),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Rate of the controller's ticks or rows, in Hz, with --execution.")
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(help="How far each joint may be from the drawn curve, in rad or m, with --execution."),
    ] = None,
    min_clearance: Annotated[
        float | None, typer.Option(help="Distance that links have to keep from obstacles, in metres.")
    ] = None,
    leave_start_contact: Annotated[
        bool, typer.Option("--leave-start-contact", help="Allow a slight contact at the start that ends.")
    ] = False,
    allowed_time: Annotated[float, typer.Option(help="How long the judgement may take, in seconds.")] = 60.0,
    output: ReplyFile = None,
    record: Annotated[
        Path | None,
        typer.Option(help="Write a recording of the motion to this .rrd.", callback=require_recording_file),
    ] = None,
    referee: Annotated[
        bool, typer.Option("--referee", help="Ask the second, independent certifier as well; it is slow.")
    ] = False,
    case: Annotated[
        Path | None,
        typer.Option(help="Write a case for the referee to this .json or .json.xz.", callback=require_writable),
    ] = None,
    proof: ProofFile = None,
    against: Annotated[
        str | None,
        typer.Option(help="MOTION are joint states, a .csv or a ROS bag: judge them against the plan of this run."),
    ] = None,
    begin: Annotated[
        float, typer.Option(help="When the motion began, in seconds since the first joint state, with --against.")
    ] = 0.0,
    topic: Annotated[str, typer.Option(help="Topic of the joint states in a bag.")] = "/joint_states",
    replay: Annotated[
        bool, typer.Option("--replay", help="MOTION is a proof: the referee checks it, and nothing else is done.")
    ] = False,
    data: Data = None,
    name: Service = "local",
) -> None:
    """Judge a motion: is it free over its whole length, and within the joints' limits?

    Unless options give them, robot, scene and the rest are those of the run, recording or certify request.

    Exit code 0 if it is, 1 if it isn't, 2 for an error. With --referee both certifiers have to say that it is.
    """
    if replay:
        raise typer.Exit(0 if replay_proofs(Path(motion), allowed_time) else 1)
    given = {
        "robot": None if robot is None else make_robot_reference(robot, srdf, package_dir or [], xacro_arg or []),
        "scene": _read_scene(scene, scale, radius, package_dir),
        "time_step": time_step,
        "interpolation": interpolation,
        "execution": _execution(execution, rate, tolerance),
        "min_clearance": min_clearance,
        "leave_start_contact": leave_start_contact or None,
    }
    if against is None:
        request = make_certify_request(motion, given, allowed_time, data, name)
    else:
        _require_nothing_else(given)
        request = make_executed_request(motion, against, begin, topic, allowed_time, data, name)
    engine = judging_engine(motion if against is None else against, data, name)
    compile_kernels(err.print, wholly=False)
    reply = engine.answer(request, record_to=record, proof_to=proof)
    assert isinstance(reply, CertifyReply), "a certify request was answered"
    if (referee or case is not None) and not run_referee(engine, request, reply, case, with_verdict=referee):
        _show(reply, output)
        raise typer.Exit(1)
    _report(reply, output)


def _execution(interpolation: str | None, rate: float | None, tolerance: float | None) -> dict[str, Any] | None:
    others = {name: value for name, value in (("rate", rate), ("tolerance", tolerance)) if value is not None}
    if interpolation is None and others:
        raise MalformedRequest(f"--{next(iter(others))} is for an --execution: give one")
    return None if interpolation is None else {"interpolation": interpolation, **others}


def _require_nothing_else(given: Mapping[str, Any]) -> None:
    for field, value in given.items():
        if value is not None:
            raise MalformedRequest(
                f"--{field.replace('_', '-')} is the run's with --against: leave it out", field=field
            )


@app.command()
def query(
    request: RequestFile,
    connect: Connect = None,
    name: ServiceName = None,
    config: ClientConfig = None,
    user: User = None,
    output: ReplyFile = None,
    record: Annotated[
        Path | None, typer.Option(help="Fetch the run's recording to this .rrd.", callback=require_recording_file)
    ] = None,
    proof: Annotated[
        Path | None,
        typer.Option(
            help="Ask for a proof that the motion is free, and fetch it to this .npz.", callback=require_proof_file
        ),
    ] = None,
    objective: ObjectiveOption = None,
    scene: SceneOption = None,
    scale: Scale = 1.0,
    radius: Radius = None,
) -> None:
    """Ask a service for a plan, a verdict or kinematics.

    Exit code 0 for a plan or an answer, 1 if the reply says that there is no plan or refuses a motion, 2 for an error.
    """
    message = _set_objective(_read_request(request, _read_scene(scene, scale, radius)), objective)
    if proof is not None and isinstance(message, requests.MotionRequest):
        message = msgspec.structs.replace(message, proof=True)
    with _connect(connect, name, config, user) as client:
        if isinstance(message, requests.PlanRequest):
            reply: Reply = client.plan(message)
        elif isinstance(message, requests.CertifyRequest):
            reply = client.certify(message)
        elif isinstance(message, requests.KinematicsRequest):
            reply = client.kinematics(message)
        else:
            raise MalformedRequest(
                f"a request file holds a plan, certify or kinematics request, not {type(message).__name__}"
            )
        if isinstance(reply, MotionReply):
            reply = fetch_files(client, reply, record, proof)
    _report(reply, output)


class UpAxis(enum.StrEnum):
    """The axis that is up in a file."""

    X = "x"
    Y = "y"
    Z = "z"


class RecordingTime(enum.StrEnum):
    """When a service renders the recordings of its runs."""

    LATER = "later"
    EAGER = "eager"


@app.command(context_settings={"auto_envvar_prefix": "GUIDEFIELD"})
def serve(
    listen: Annotated[
        list[str] | None, typer.Option(help=f"Zenoh endpoint, may be repeated; else {DEFAULT_LISTEN}.")
    ] = None,
    name: Annotated[str, typer.Option(help="Name of this service; part of its keys.")] = "local",
    workers: Annotated[int, typer.Option(min=1, max=1024, help="Worker processes.")] = usable_processors(),
    streams: Annotated[
        int, typer.Option(min=0, help="How many streams may be open at once, each in a process of its own.")
    ] = DEFAULT_STREAMS,
    # `DEFAULT_QUEUE` of `endpoint/service.py`, which the wire page tells
    queue: Annotated[int, typer.Option(min=1, help="How many requests may wait.")] = 64,
    memory: Annotated[int, typer.Option(min=256, help="Memory that a worker may take [MiB].")] = DEFAULT_MEMORY >> 20,
    config: Annotated[Path | None, typer.Option(help="Zenoh configuration file (TLS, users, routers).")] = None,
    data: Annotated[
        Path | None, typer.Option(help="Folder of runs, scenes and robots; else ~/.local/share/guidefield/NAME.")
    ] = None,
    packages: Annotated[
        list[Path] | None,
        typer.Option(exists=True, file_okay=False, help="Folder of packages whose meshes clients' robots may use."),
    ] = None,
    prepare: Annotated[
        list[str] | None,
        typer.Option(
            help="Robot to prepare for its first plan before serving; may be repeated.", autocompletion=_complete_robot
        ),
    ] = None,
    keep_runs: Annotated[int, typer.Option(min=1, help="How many runs are kept.")] = Retention.runs,
    keep_gib: Annotated[float, typer.Option(min=0.01, help="How large they may be together [GiB].")] = Retention.bytes
    / 2**30,
    keep_days: Annotated[float, typer.Option(min=0.0, help="How many days they are kept.")] = float("inf"),
    quota: Annotated[
        Path | None, typer.Option(help="JSON file with what each user may have.", exists=True, dir_okay=False)
    ] = None,
    recordings: Annotated[
        RecordingTime,
        typer.Option(help="When recordings are rendered: at low priority, or before a worker takes its next query."),
    ] = RecordingTime.LATER,
    json_logs: Annotated[bool, typer.Option("--json-logs", help="Log one JSON object a line.")] = False,
    otel: Annotated[
        bool, typer.Option("--otel", help="Trace queries with OpenTelemetry (needs the extra otel).")
    ] = False,
    metrics: Annotated[
        int | None,
        typer.Option(min=1, max=65_535, help="Port on loopback for metrics and health (needs the extra metrics)."),
    ] = None,
    ros: Annotated[
        bool, typer.Option("--ros", help="Answer ROS 2 nodes on rmw_zenoh, as MoveIt does (needs the extra ros).")
    ] = False,
    ros_robot: Annotated[str, typer.Option(help="The robot that ROS 2 nodes ask about.")] = "panda",
    ros_domain: Annotated[int, typer.Option(min=0, max=232, help="Their ROS domain.")] = 0,
    ros_distro: Annotated[Distribution, typer.Option(help="Their distribution.")] = Distribution.JAZZY,
    ros_connect: Annotated[
        str | None, typer.Option(help="Zenoh endpoint of the router, rmw_zenohd, that they are reached through.")
    ] = None,
    show: Show = False,
    viewer: Viewer = None,
) -> None:
    """Serve over Zenoh until Ctrl-C or SIGTERM; on loopback only, unless told otherwise.

    Each option has an environment variable, as GUIDEFIELD_WORKERS for --workers. In it, values of an option that may
    be repeated are separated by spaces, folders by colons.
    """
    from guidefield.cli import serving
    from guidefield.endpoint.service import ServiceSettings

    settings = ServiceSettings(
        data=default_data_folder(name) if data is None else data,
        instance=name,
        listen=tuple(listen) if listen else None,
        config=config,
        workers=workers,
        streams=streams,
        queue_limit=queue,
        memory=memory << 20,
        retention=Retention(keep_runs, int(keep_gib * 2**30), keep_days * 86_400.0),
        eager_recordings=recordings is RecordingTime.EAGER,
        viewer=_choose_viewer(viewer, show=show),
        json_logs=json_logs,
        otel=otel,
        metrics=metrics,
        packages=tuple(folder.resolve() for folder in packages or ()),
        prepare=tuple(prepare or ()),
        quotas=DEFAULT_QUOTAS if quota is None else serving.read_quotas(quota),
        ros=RosSettings(ros_robot, ros_domain, ros_distro, ros_connect) if ros else None,
    )
    serving.serve_until_signal(settings, typer.echo)
    serving.leave()


@app.command()
def secure(
    folder: Annotated[Path, typer.Argument(help="Where the files go.", file_okay=False)],
    operator: Annotated[
        list[str] | None, typer.Option(help="Who may do everything, may be repeated; else operator.")
    ] = None,
    user: Annotated[list[str] | None, typer.Option(help="Who has keys of its own, may be repeated; else user.")] = None,
    onlooker: Annotated[
        list[str] | None, typer.Option(help="Who sees lists and what is shared, may be repeated; else onlooker.")
    ] = None,
    host: Annotated[
        list[str] | None, typer.Option(help="How clients reach this machine, may be repeated; else localhost.")
    ] = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Where the service listens.")] = 7447,
) -> None:
    """Write certificates, passwords and Zenoh configurations for a service that a network can reach.

    One file is for the service, service.json5, and one for each who may use it.
    """
    try:
        from guidefield.cli.securing import LOCAL_HOSTS, Roles, write_files
    except ImportError:
        raise CannotStart("certificates need a package more: pip install 'guidefield[secure]'") from None
    roles = Roles(tuple(operator or Roles.operators), tuple(user or Roles.users), tuple(onlooker or Roles.onlookers))
    for path in write_files(folder, roles, tuple(host or LOCAL_HOSTS), port):
        typer.echo(str(path))


@app.command()
def batch(
    requests: Annotated[Path, typer.Argument(help="File with one JSON request on each line.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of results and recordings.")] = Path("batch"),
    workers: Annotated[
        int, typer.Option(min=1, max=1024, help="Worker processes on this machine.")
    ] = usable_processors(),
    ray: Annotated[str | None, typer.Option(help="Address of a Ray cluster that works instead.")] = None,
    recordings: Annotated[bool, typer.Option(help="Record the plans.")] = True,
    render: Annotated[
        bool, typer.Option(help="Render the recordings after the answers; else `guidefield runs render` does.")
    ] = True,
) -> None:
    """Answer the requests of a file; called again after an interruption, go on where it ended."""
    from guidefield.cli.batch import run

    compile_kernels(err.print)
    raise typer.Exit(run(requests, output, err, workers=workers, ray=ray, recordings=recordings, render=render))


@app.command()
def robots(
    robot: Annotated[
        str | None,
        typer.Argument(
            help="A robot, by its name or by its .urdf, .xacro or .xml file, to be told all about it.",
            autocompletion=_complete_robot,
        ),
    ] = None,
    srdf: Annotated[Path | None, typer.Option(help="The SRDF of a robot file.")] = None,
    package_dir: PackageFolders = None,
    xacro_arg: XacroArguments = None,
    json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """List the robots that can be named in a request, or describe one: one of them, or your own."""
    from guidefield.engine import answer

    if robot is None:
        reply = answer(requests.ReadRobots())
    else:
        reply = answer(requests.ReadRobot(make_robot_reference(robot, srdf, package_dir or [], xacro_arg or [])))
    if json:
        typer.echo(_format_json(reply))
    elif isinstance(reply, RobotsReply):
        out.print(robots_table(reply, narrow=out.width < WIDTH_OF_ALL_COLUMNS))
    elif isinstance(reply, RobotReply):
        out.print(robot_table(reply))


@app.command()
def demo(
    folder: Annotated[Path, typer.Option(help="Where the recordings go.")] = Path("runs"),
    stream: Annotated[
        bool, typer.Option("--stream", help="A Panda serves at a table where boxes drift through, instead.")
    ] = False,
) -> None:
    """Start a service, have it plan twice for a Panda at a bookshelf, and show the results."""
    from guidefield.cli import demonstration

    raise typer.Exit(demonstration.run_stream(folder, out) if stream else demonstration.run(folder, out))


@app.command()
def show(
    run: Annotated[
        str | None,
        typer.Argument(help="Id of a kept run or stream, or a file (.rrd or .stream); with --web it may be left out."),
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="Show it in a web browser instead of a window.")] = False,
    robot: Annotated[str, typer.Option(help="The robot of the page.", autocompletion=_complete_robot)] = "panda",
    scene: Annotated[str, typer.Option(help="The scene of the page.", autocompletion=_complete_scene)] = "bookshelf",
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="The page's port on loopback; if it is occupied, the next free one.")
    ] = 8080,
    data: Data = None,
    name: Service = "local",
) -> None:
    """Open a recording in the Rerun viewer, on this machine only.

    With --web and no run, a page opens in which you drag a goal and obstacles; each change is planned for (needs the
    extra web).
    """
    from guidefield.cli import showing

    if run is None:
        if not web:
            raise MalformedRequest("name a run or a recording's file; --web alone opens a page to try")
        try:
            from guidefield.cli.trying import serve_page
        except ImportError:
            raise CannotShow("the page needs a package more: pip install 'guidefield[web]'") from None
        compile_kernels(err.print, wholly=False)
        serve_page(robot, scene, port, out)
        return
    with recording_file(run, data, name) as file:
        raise typer.Exit(showing.show_in_browser(file, out) if web else showing.show_in_window(file, err))


@app.command()
def mcp(
    connect: Connect = None,
    name: ServiceName = None,
    config: ClientConfig = None,
    user: User = None,
) -> None:
    """Serve plans to a client of the Model Context Protocol, over standard input and output (needs the extra mcp).

    It asks a service, and never moves a robot: plan, certify, clearance, inverse kinematics, robots, scenes.
    """
    from guidefield.mcp_server import serve_stdio

    try:
        serve_stdio(tuple(connect or ()), name, config, user)
    except ImportError:
        raise CannotStart("this needs the package mcp: pip install 'guidefield[mcp]'") from None


@app.command()
def doctor(
    data: Data = None,
    name: Service = "local",
    json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """Say what is wrong with this machine and what to do: processors, memory, disk, kernels, clock, Zenoh, graphics.

    Exit code 0 if a service can work here, 1 if something is wrong.
    """
    from guidefield.doctor import FindingState, examination

    findings = []
    for finding in examination(default_data_folder(name) if data is None else data):
        findings.append(finding)
        if not json:
            out.print(_format_finding(finding), soft_wrap=True)
    if json:
        text = msgspec.json.format(msgspec.json.encode(findings), indent=1).decode()
        out.print(text, highlight=False, markup=False, soft_wrap=True)
    raise typer.Exit(int(any(finding.state is FindingState.WRONG for finding in findings)))


def _format_finding(finding: Finding) -> Text:
    from guidefield.doctor import FindingState

    advice = f": {finding.advice}" if finding.advice else ""
    colour = {FindingState.FINE: "green", FindingState.REMARK: "yellow", FindingState.WRONG: "red"}[finding.state]
    return Text.assemble(f"{finding.about:<9}", (f"{finding.state:<7}", colour), f"{finding.found}{advice}")


@app.command()
def docs(
    subject: Annotated[
        str | None,
        typer.Argument(
            help="A page or a message, such as PlanRequest; without it the pages are listed.",
            autocompletion=_complete_subject,
        ),
    ] = None,
) -> None:
    """Read the documentation: how plans are made, what is certified, the service, the wire, robots, scenes."""
    from guidefield.cli.documentation import pages_table, show_page

    if subject is None:
        out.print(pages_table())
    else:
        show_page(subject, out)


@scenes_app.command("import")
def import_scene(
    file: Annotated[Path, typer.Argument(help="A mesh, a cloud, a MoveIt .scene, URDF, xacro, SDF or MJCF.")],
    named: Annotated[str | None, typer.Option("--as", help="Name of the scene; else that of the file.")] = None,
    scale: Scale = 1.0,
    up: Annotated[UpAxis | None, typer.Option(help="The axis that is up in the file; else what it says, or z.")] = None,
    radius: Radius = None,
    prefix: Annotated[str, typer.Option(help="Begins the name of each obstacle.")] = "",
    package_dir: PackageFolders = None,
    xacro_arg: XacroArguments = None,
    without: Annotated[
        list[str] | None,
        typer.Option(help="An object, model or link that is left out with all below it; can be repeated."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Write the scene here, as JSON, instead.", callback=require_writable),
    ] = None,
    connect: Connect = None,
    name: ServiceName = None,
    config: ClientConfig = None,
    user: User = None,
) -> None:
    """Read a scene from a file of any kind, and store it at a service; or write it to a file."""
    scene = read_scene_file(
        file,
        name=named,
        scale=scale,
        up=up,
        radius=radius,
        prefix=prefix,
        package_dirs=package_dir or (),
        xacro_args=split_xacro_arguments(xacro_arg or ()),
        without=without or (),
    )
    count = len(scene.obstacles)
    said = f"{count} obstacle{'s' if count > 1 else ''}: {list_choices([one.name for one in scene.obstacles])}"
    if output is not None:
        output.write_bytes(codec.encode(scene))
        typer.echo(f"{output}: {said}")
        return
    with _connect(connect, name, config, user) as client:
        for sentence in client.store_scene(scene):
            typer.echo(f"warning: {sentence}", err=True)
    typer.echo(f"scene {scene.name!r} is stored, {said}")


app.add_typer(runs_app, name="runs")
app.add_typer(scenes_app, name="scenes")
app.command()(replay)
app.command()(execute)


def _join_lines(text: str) -> str:
    """Join the lines of each paragraph: Typer keeps line breaks, which are ragged in a narrow terminal."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in inspect.cleandoc(text).split("\n\n"))


class _FlagsWithoutType:
    """A command, or group of them, whose help shows no type beside flags: they take no value."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, as Typer does."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
        return params


class _Command(_FlagsWithoutType, TyperCommand):
    pass


class _Group(_FlagsWithoutType, TyperGroup):
    pass


for _app in (app, runs_app, scenes_app):
    _app.info.cls = _Group
    for _command in _app.registered_commands:
        assert _command.callback is not None, "each command is a function"
        _command.help, _command.cls = _join_lines(_command.callback.__doc__ or ""), _Command


def _choose_viewer(viewer: str | None, *, show: bool) -> str | None:
    if viewer is not None and not is_listening(viewer):
        raise CannotShow(f"no viewer listens at {viewer}")
    return find_viewer(partial(err.print, soft_wrap=True)) if show and viewer is None else viewer


def _connect(endpoints: list[str] | None, name: str | None, config: Path | None, user: str | None) -> Client:
    from guidefield.client import Client

    try:
        return Client.connect(*(endpoints or ()), instance=name, config=config, user=user)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="'--config'" if not endpoints else "'--connect'") from None


def _read_scene(
    scene: str | None, scale: float, radius: float | None, package_dirs: Sequence[Path] | None = None
) -> requests.SceneReference | None:
    if scene is None or not _is_scene_file(scene):
        if scale != 1.0 or radius is not None:
            raise MalformedRequest("--scale and --radius go with a --scene that is a file")
        return scene
    return read_scene_file(Path(scene), scale=scale, radius=radius, package_dirs=package_dirs or ())


def _is_scene_file(scene: str) -> bool:
    if not Path(scene).suffix:
        return False
    from guidefield.scene_files.reading import SUFFIXES  # with NumPy and Pinocchio, which most commands don't need

    return scene.lower().endswith(SUFFIXES) or Path(scene).is_file()


def _read_request(path: Path, scene: requests.SceneReference | None = None) -> requests.Request:
    try:
        content = sys.stdin.buffer.read() if str(path) == "-" else path.read_bytes()
    except OSError as error:
        raise MalformedRequest(f"the request can't be read: {path}: {error.strerror}", path=str(path)) from None
    try:
        if scene is None:
            return codec.decode_request(content)
        fields = codec.decode(content, dict[str, Any])
        return codec.decode_request({**fields, "scene": msgspec.to_builtins(scene)})
    except MalformedRequest as error:
        where = "standard input" if str(path) == "-" else path
        raise MalformedRequest(f"{where}: {error.message}", **error.details) from None


def _set_objective(request: requests.Request, objective: requests.Objective | None) -> requests.Request:
    if objective is None:
        return request
    if not isinstance(request, requests.PlanRequest):
        raise MalformedRequest(f"--objective goes with a plan request, not with a {type(request).__name__}")
    return msgspec.structs.replace(request, objective=objective)


def _report(reply: Reply, output: Path | None) -> NoReturn:
    _show(reply, output)
    good = not isinstance(reply, PlanReply | CertifyReply) or reply.status.code == Status.SUCCESS
    raise typer.Exit(0 if good else 1)


def _show(reply: Reply, output: Path | None) -> None:
    if output is not None:
        output.write_text(_format_json(reply) + "\n")
    if isinstance(reply, PlanReply | CertifyReply):
        out.print(motion_table(reply))
    elif output is None:
        typer.echo(_format_json(reply))


def _format_json(reply: Reply) -> str:
    return msgspec.json.format(codec.encode(reply), indent=1).decode()


def _describe(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def _name(error: Exception) -> str:
    return error.code.name if isinstance(error, GuidefieldError) else type(error).__name__
