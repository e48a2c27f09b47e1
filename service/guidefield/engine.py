"""The engine: answer one request with its handler, the robot catalog, the stores and the recorder; no network.

A new kind of request about stored things gets a line in `Engine`'s handlers, one with a deadline of its own a branch of
`_dispatch`; kinematics requests need nothing here. Imports of heavy packages stay inside functions: an engine that only
reads scenes and runs stays light.
"""

from __future__ import annotations

import contextlib
import enum
import functools
import importlib
import logging
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import msgspec

from guidefield.deadline import UNLIMITED, Deadline, DeadlineExpired
from guidefield.errors import (
    GuidefieldError,
    MalformedRequest,
    RobotInvalid,
    SceneInvalid,
    at_path,
    convert_exception,
)
from guidefield.first_start import compile_kernels
from guidefield.handlers.info import Figures, info
from guidefield.memory import pause_collector
from guidefield.messages import requests
from guidefield.messages.codec import read_request
from guidefield.messages.faults import field_path
from guidefield.messages.replies import (
    CertifyReply,
    Done,
    InfoReply,
    PlanReply,
    RobotReply,
    RobotsReply,
    RobotSummary,
    SceneReply,
    ScenesReply,
)
from guidefield.messages.scene import Obstacle, Scene as SceneMessage
from guidefield.messages.scene_changes import RequestScene, SceneDiff, apply_change, copy_scene
from guidefield.messages.streams import StreamOpen
from guidefield.messages.values import Reply
from guidefield.run import Destination, ProgressReporter, Run, Watcher
from guidefield.stores.by_user import Kind
from guidefield.stores.recordings import PROOF, Recordings
from guidefield.stores.robots import NoRobots, Robots
from guidefield.stores.runs import NoRuns, Runs
from guidefield.stores.scenes import PackagedScenes

if TYPE_CHECKING:
    from guidefield.case_file import Motion
    from guidefield.robot.catalog import Catalog
    from guidefield.robot.library import SentRobot
    from guidefield.robot.model.model import RobotModel
    from guidefield.run_log import RobotOrigin
    from guidefield.scene.anchor import Anchor
    from guidefield.scene.scene import BuiltScenes, Scene
    from guidefield.stream.path_planner import TakeOver
    from guidefield.stream.state import StreamWatcher
    from guidefield.stream.stream import CertifiedStream

Lend = Callable[[Kind, str, str], "Engine"]
"""Returns the engine of a user that shares something of a kind and name; raises NotAllowed if it isn't shared."""

_log = logging.getLogger(__name__)

_R = TypeVar("_R", PlanReply, CertifyReply)
_Asked = TypeVar("_Asked", bound=requests.Request)


class LocalFiles(enum.Enum):
    """Permission to name a URDF file on this machine."""

    ALLOWED = "allowed"
    REFUSED = "refused"


@dataclass(frozen=True)
class _RequestContext:
    asked: requests.Request  # as it came, in the world's coordinates
    received: float  # arrival, by `time.monotonic()` [s]
    watcher: Watcher | None
    load: _RobotLoader
    began: float | None = None  # begin of loading, if before its handler's, by the same clock [s]
    deferred: bool = False  # whether only the log of its recording is written
    proof_to: Path | None = None
    anchor: Anchor | None = None  # the far-away point that handlers get positions relative to


class SharedCaches:
    """Caches of robots and scenes that engines share: they depend on no store."""

    def __init__(self, packages: Sequence[Path]) -> None:
        self.packages = tuple(packages)

    @functools.cached_property
    def catalog(self) -> Catalog:
        """The loaded robots."""
        from guidefield.robot.catalog import Catalog

        return Catalog(self.packages)

    @functools.cached_property
    def scenes(self) -> BuiltScenes:
        """The built scenes."""
        from guidefield.scene.scene import BuiltScenes

        return BuiltScenes()


class Engine:
    """Answers requests; one at a time.

    Args:
        instance: Name of the service, with the user if it is one's; part of the key of a recording.
        runs: Store of a service's runs; None: none, as of the other stores.
        recordings: Store of recordings and proofs.
        scenes: Stored scenes; None: only those of the package.
        robots: Robots that clients stored.
        local_files: Whether a request may name a URDF file.
        packages: Folders of packages with meshes, unless `loaded` has them.
        loaded: Caches shared with other engines; None: its own.
        lend: Finds the engine with another user's thing, ``user:name``.
        viewer: Address of a running Rerun viewer that shows runs and streams; None: none.
    """

    def __init__(
        self,
        instance: str = "local",
        *,
        runs: Runs | None = None,
        recordings: Recordings | None = None,
        scenes: PackagedScenes | None = None,
        robots: Robots | None = None,
        local_files: LocalFiles = LocalFiles.ALLOWED,
        packages: Sequence[Path] = (),
        loaded: SharedCaches | None = None,
        lend: Lend | None = None,
        viewer: str | None = None,
    ) -> None:
        self._instance = instance
        self._loaded = loaded or SharedCaches(tuple(packages))
        self._lend, self._viewer = lend, viewer
        self._runs: Runs = NoRuns() if runs is None else runs
        self._recordings = recordings
        self._scenes = PackagedScenes() if scenes is None else scenes
        self._robots: Robots = NoRobots() if robots is None else robots
        self._local_files = local_files
        self._compiled = False
        self._began = time.monotonic()
        self._counters = Counter(answered=0, refused=0)
        self._handlers: dict[type, Callable[[Any], Reply]] = {
            requests.ReadRobots: self._read_robots,
            requests.ReadRobot: self._read_robot,
            requests.StoreRobot: self._store_robot,
            requests.DeleteRobot: self._delete_robot,
            requests.ReadScenes: lambda _: ScenesReply(scenes=self._scenes.names()),
            requests.ReadScene: self._read_scene,
            requests.StoreScene: self._store_scene,
            requests.ChangeScene: self._change_scene,
            requests.DeleteScene: self._delete_scene,
            requests.ReadRuns: self._runs.list,
            requests.ReadRun: lambda request: self._runs.read(request.run_id),
            requests.DeleteRun: self._delete_run,
            requests.ReadInfo: self._read_info,
        }

    def answer(
        self,
        request: bytes | str | dict[str, Any] | requests.Request,
        *,
        record_to: Path | None = None,
        proof_to: Path | None = None,
        deferred: bool = False,
        received: float | None = None,
        watcher: Watcher | None = None,
        came: float | None = None,
    ) -> Reply:
        """Answer one request of any kind.

        Args:
            request: JSON bytes, plain data, or a Struct.
            record_to: Where to write the recording of a plan or judgement; None leaves that to the store of runs.
            proof_to: Where to write the proof of a plan or judgement, which then is asked for; None: where the request
                asks for one, beside the recording.
            deferred: True to write only the log of that file, which ends with .rrd, beside it.
            received: Arrival of the request, by `time.monotonic()` [s]; deadlines count from it. None: `came`, but
                without the time in which the planner is loaded and the robot prepared for its first use.
            watcher: Takes progress, and may end the run.
            came: Begin of decoding, on the same clock [s], if it was decoded before this call; None: now. Without
                `received`, decoding counts for the deadline, and as loading.

        Raises:
            GuidefieldError: any error that travels as ``reply_err``; DiskRefused for a disk, and InternalFailure for a
                bug, both logged with their trace.
        """
        came = time.monotonic() if came is None else came
        try:
            decoded: Any = request
            if not isinstance(request, msgspec.Struct):
                decoded = read_request(request)
            if proof_to is not None:
                decoded = _with_proof(decoded)
            with pause_collector() if self._is_first(decoded, received) else contextlib.nullcontext():
                began, load = None, _RobotLoader(self._find_origin, self._loaded)
                if received is None:
                    read = time.monotonic() - came
                    ready = self._load_ahead(decoded, load)
                    received = began = came if ready else time.monotonic() - read
                near, anchor = _move_to_anchor(decoded, load)
                context = _RequestContext(decoded, received, watcher, load, began, deferred, proof_to, anchor)
                reply = self._dispatch(near, record_to, context)
                reply = reply if anchor is None else anchor.outward(reply)
        except GuidefieldError as error:
            self._counters["refused"] += 1
            if "path" not in error.details and (path := field_path(error.message, "$")) != "$":
                error.details["path"] = path
            raise
        except Exception as error:
            self._counters["refused"] += 1
            _log.exception("a request failed by itself")
            raise convert_exception(error) from error
        self._counters["answered"] += 1
        return reply

    def _is_first(self, request: requests.Request, received: float | None) -> bool:
        needs = isinstance(request, requests.MotionRequest | requests.KinematicsRequest)
        return needs and received is None and not self._compiled

    def _load_ahead(self, request: requests.Request, load: _RobotLoader) -> bool:
        """Load and prepare a request's needs before its time begins; return whether a plan's were ready before."""
        compiled = self._compiled
        if self._is_first(request, None):
            compile_kernels(_log.warning, wholly=False)
            self._compiled = True
        if isinstance(request, requests.PlanRequest):
            from guidefield.handlers.plan import prepare_ahead

            if request.steps:
                importlib.import_module("guidefield.handlers.sequence")
            return prepare_ahead(_move_to_anchor(request, load)[0], load, self._find_scene_message) and compiled
        if isinstance(request, requests.CertifyRequest):
            from guidefield.handlers.certify import lay_out_ahead

            lay_out_ahead(_move_to_anchor(request, load)[0], load)
        return False

    def warm_up(self, robots: Sequence[str] = (), recorder: bool = False) -> None:
        """Load packages and kernels, and prepare robots, so that the first plan doesn't wait for them.

        Args:
            robots: Robots of the catalog.
            recorder: Whether recordings are rendered in this process, too, for a viewer: loading that takes as long
                as all the rest, and as much memory.

        Raises:
            RobotInvalid: if a robot is unknown or can't be used.
        """
        compile_kernels(_log.info)
        rooms = ["handlers.plan", "handlers.certify"]
        if recorder or self._viewer is not None:
            rooms.append("recorder.recorder")
        if self._viewer is not None:
            rooms.append("recorder.live_view")
        with pause_collector():
            for room in rooms:
                importlib.import_module(f"guidefield.{room}")
            importlib.import_module("guidefield.kernels.jit.decorators").load_imported()
        self.answer(requests.Potential(scene=self._scenes.names()[0], points=[(0.0, 0.0, 0.0)]))
        preparation = importlib.import_module("guidefield.handlers.preparation")
        for robot in robots:
            preparation.prepare(self._load_robot(robot))

    def prepare(self, request: requests.PlanRequest, deadline: Deadline) -> None:
        """Prepare the robot of a plan, as far as the deadline allows.

        Raises RobotInvalid if the robot can't be used; DeadlineExpired if the deadline passed before all is prepared.
        """
        from guidefield.handlers.plan import prepare_ahead
        from guidefield.handlers.preparation import prepare

        prepare(self._load_robot(request.robot), deadline)
        deadline.check("the links were laid out")
        prepare_ahead(_move_to_anchor(request, self._load_robot)[0], self._load_robot, self._find_scene_message)

    def _dispatch(self, request: requests.Request, record_to: Path | None, context: _RequestContext) -> Reply:
        if isinstance(request, requests.PlanRequest):
            return self._plan(request, record_to, context)
        if isinstance(request, requests.CertifyRequest):
            return self._certify(request, record_to, context)
        if isinstance(request, requests.KinematicsRequest) and record_to is None:
            return self._answer_kinematics(request, context)
        kind = type(request)
        if record_to is not None:
            raise MalformedRequest(f"only a plan or a judgement can be recorded, not {kind.__name__}")
        if kind not in self._handlers:
            raise MalformedRequest(f"{kind.__name__} is no request", path="$")
        return self._handlers[kind](request)

    def _plan(self, request: requests.PlanRequest, record_to: Path | None, context: _RequestContext) -> PlanReply:
        from guidefield.handlers.plan import answer_plan
        from guidefield.handlers.sequence import answer_steps

        answer = answer_steps if request.steps else answer_plan
        return self._run(
            request,
            request.allowed_planning_time,
            record_to,
            context,
            lambda run: partial(answer, preparing=run.prepare),
        )

    def _certify(
        self, request: requests.CertifyRequest, record_to: Path | None, context: _RequestContext
    ) -> CertifyReply:
        from guidefield.handlers.certify import answer_certify

        return self._run(request, request.allowed_time, record_to, context, lambda _: answer_certify)

    def _run(
        self,
        request: requests.MotionRequest,
        allowed: float,
        record_to: Path | None,
        context: _RequestContext,
        handler: Callable[[Run], Callable[..., _R]],
    ) -> _R:
        run_id = request.run_id or uuid.uuid4().hex
        to: Destination | None = None
        proof_to = context.proof_to
        if record_to is not None:
            log = (Recordings(record_to.parent), record_to.stem) if context.deferred else None
            to = Destination(record_to, str(record_to), log=log)
            proof_to = proof_to or record_to.with_suffix(PROOF)
        proof_place = None if proof_to is None else (proof_to, str(proof_to))
        if self._recordings is not None:
            key = f"guidefield/{self._instance}/runs/{run_id}"
            to = to or Destination.stored(self._recordings, run_id, f"{key}/recording")
            proof_place = proof_place or (self._recordings.file(run_id, PROOF), f"{key}/proof")
        watcher, received = context.watcher, context.received
        progress = None if watcher is None else ProgressReporter(run_id, received, watcher)
        asked = cast(requests.MotionRequest, context.asked)
        run = Run(run_id, asked, to, context.load.origin, progress, proof_place, context.anchor, self._viewer)
        deadline = Deadline(received + allowed, run.is_cancelled)
        try:
            began = time.monotonic() if context.began is None else context.began
            reply = handler(run)(
                request,
                context.load(request.robot),
                run.see(self._build_scene(request.scene, deadline)),
                run_id=run_id,
                received=received,
                deadline=deadline,
                began=began,
                record=run.record,
                prove=run.prove,
            )
            return run.end(reply, received)
        except DeadlineExpired as late:
            from guidefield.handlers.expired import ended_run

            return run.end(cast(_R, ended_run(run_id, request, late, time.monotonic() - received)))

    def motions_of(self, request: requests.CertifyRequest) -> list[Motion]:
        """Return the parts of a certify request's motion for the referee's file; GuidefieldError if it is ill-posed."""
        from guidefield.handlers.certify import motions_of

        near, anchor = _move_to_anchor(request, self._load_robot)
        scene = self._build_scene(request.scene)
        seen = scene if anchor is None else anchor.see(scene)
        made = motions_of(near, self._load_robot(request.robot), seen)
        return [replace(one, anchor=anchor) for one in made]

    def robot(self, name: str) -> RobotModel:
        """Return the robot of a name; raises RobotInvalid if there is none, or it can't be used."""
        return self._load_robot(name)

    def stream(
        self, request: StreamOpen, taking: TakeOver | None = None, watching: StreamWatcher | None = None
    ) -> CertifiedStream:
        """Open a stream in this process; its observer may store it.

        Args:
            taking: Times at which paths planned beside the cycle are taken over; None: counted.
            watching: Observer of its updates and answers; None: none.

        Raises:
            GuidefieldError: if the request is ill-posed.
        """
        from guidefield.stream.stream import CertifiedStream

        stream = CertifiedStream(
            request, self._load_robot(request.robot), self._build_scene(request.scene), taking, watching
        )
        if self._viewer is not None and watching is not None:
            from guidefield.stream.shown import LiveStream

            stream.watch(LiveStream(self._viewer, stream))
        return stream

    def _answer_kinematics(self, request: requests.KinematicsRequest, context: _RequestContext) -> Reply:
        from guidefield.handlers.expired import ended_work
        from guidefield.handlers.kinematics import answer_kinematics
        from guidefield.handlers.preparation import prepare_field

        watcher, until = context.watcher, context.received + request.allowed_time
        deadline = Deadline(until) if watcher is None else Deadline(until, watcher.is_cancelled)
        robot = None if request.robot is None else self._load_robot(request.robot)
        reference: requests.SceneReference | None = getattr(request, "scene", None)
        try:
            scene = None if reference is None else self._build_scene(reference, deadline)
            if scene is not None and isinstance(request, requests.Potential):
                prepare_field(scene, deadline)
            if watcher is not None:
                watcher.be_prepared()
            if context.anchor is None:
                return answer_kinematics(request, robot, scene, deadline)
            reply: Any = answer_kinematics(
                request, robot, None if scene is None else context.anchor.see(scene), deadline
            )
            coarse = context.anchor.coarse_warnings(context.asked, scene)
            return cast(Reply, msgspec.structs.replace(reply, warnings=[*reply.warnings, *coarse]))
        except DeadlineExpired as late:
            raise ended_work(late, request.allowed_time) from None

    def _read_robots(self, _request: requests.ReadRobots) -> RobotsReply:
        from guidefield.handlers.robots import robots

        return robots(self._loaded.catalog, self._robots)

    def _read_robot(self, request: requests.ReadRobot) -> RobotReply:
        from guidefield.handlers.robots import robot

        return robot(self._load_robot(request.robot))

    def _store_robot(self, request: requests.StoreRobot) -> Done:
        from guidefield.handlers.robots import prepare_stored

        self._robots.write(request.name, request.files, self._loaded.catalog.load)
        stored = self._load_robot(request.name)
        return Done(done=f"robot {request.name!r} is stored{prepare_stored(stored)}", warnings=list(stored.warnings))

    def _delete_robot(self, request: requests.DeleteRobot) -> Done:
        self._robots.delete(request.name)
        return Done(done=f"robot {request.name!r} is deleted")

    def _read_scene(self, request: requests.ReadScene) -> SceneReply:
        scene, version = self._scenes.read(request.name, request.version)
        return SceneReply(copy_scene(scene), version)

    def _store_scene(self, request: requests.StoreScene) -> Done:
        built = self._build_scene(request.scene)
        version = self._scenes.write(request.scene)
        return Done(done=f"scene {request.name!r} is stored", warnings=list(built.warnings), version=version)

    def _change_scene(self, request: requests.ChangeScene) -> Done:
        coming = request.diff.add
        with at_path("$.diff"):
            warnings: Sequence[str] = ()
            if coming:
                added = apply_change(SceneMessage(request.name), SceneDiff(add=coming))
                with _at_added_fault(coming):
                    warnings = self._loaded.scenes.of(added).warnings
            _, version = self._scenes.change(request.name, request.diff)
        return Done(done=f"scene {request.name!r} is changed", warnings=list(warnings), version=version)

    def _delete_scene(self, request: requests.DeleteScene) -> Done:
        self._scenes.delete(request.name)
        return Done(done=f"scene {request.name!r} is deleted")

    def _delete_run(self, request: requests.DeleteRun) -> Done:
        self._runs.delete(request.run_id)
        return Done(done=f"run {request.run_id!r} is deleted")

    def _read_info(self, _request: requests.ReadInfo) -> InfoReply:
        return info(Figures(self._counters, time.monotonic() - self._began))

    def summaries(self, names: Sequence[str]) -> list[RobotSummary]:
        """Summarize other users' robots, named ``user:name``; some may have been deleted."""
        from guidefield.handlers.robots import summaries_of

        found = []
        for name in names:
            holder, own = self._find_holder("robots", name)
            lines = summaries_of(self._loaded.catalog, holder._robots, [own])
            found += [msgspec.structs.replace(line, name=name) for line in lines]
        return found

    def _find_holder(self, kind: Kind, name: str) -> tuple[Engine, str]:
        user, colon, own = name.partition(":")
        return (self, name) if not colon or self._lend is None else (self._lend(kind, user, own), own)

    def _load_robot(self, reference: requests.RobotReference) -> RobotModel:
        with at_path("$.robot"):
            return self._loaded.catalog.load(self._find_origin(reference))

    def _find_origin(self, reference: requests.RobotReference) -> requests.RobotReference | SentRobot:
        local = not isinstance(reference, str) or reference.startswith(requests.ROBOT_DESCRIPTIONS)
        if local and not isinstance(reference, requests.UrdfText) and self._local_files is LocalFiles.REFUSED:
            named = "a robot of robot_descriptions" if isinstance(reference, str) else "a robot in a local file"
            raise RobotInvalid(
                f"{named} can be named in Python and on the command line only: "
                "store it with its meshes (`Client.store_robot`), or send its text as a `urdf`",
                path=reference if isinstance(reference, str) else reference.path,
            )
        if not isinstance(reference, str):
            return reference
        holder, name = self._find_holder("robots", reference)
        return holder._robots.find(name) or name

    def _build_scene(self, reference: requests.SceneReference, deadline: Deadline = UNLIMITED) -> Scene:
        with at_path("$.scene"), _at_scene_fault(reference):
            return self._loaded.scenes.of(self._find_scene_message(reference), deadline)

    def _find_scene_message(self, reference: requests.SceneReference) -> SceneMessage:
        if isinstance(reference, str):
            return self._read_stored_scene(reference, None)
        if not isinstance(reference, RequestScene) or reference.base is None:
            return reference
        base = self._read_stored_scene(reference.base, reference.version)
        return apply_change(base, reference, reference.name)

    def _read_stored_scene(self, reference: str, version: int | None) -> SceneMessage:
        holder, name = self._find_holder("scenes", reference)
        return holder._scenes.read(name, version)[0]


def _move_to_anchor(
    request: _Asked, load: Callable[[requests.RobotReference], RobotModel]
) -> tuple[_Asked, Anchor | None]:
    """Return a request relative to an anchor near its robot, with the anchor; near the origin as it came, and None."""
    if not isinstance(request, requests.MotionRequest | requests.KinematicsRequest):
        return request, None
    from guidefield.scene.anchor import Anchor

    anchor = Anchor.of(request, load)
    return (request, None) if anchor is None else (anchor.inward(request), anchor)


def _with_proof(request: requests.Request) -> requests.Request:
    if not isinstance(request, requests.MotionRequest):
        raise MalformedRequest(f"only a plan or a judgement can be proved, not {type(request).__name__}")
    return request if request.proof else msgspec.structs.replace(request, proof=True)


@contextlib.contextmanager
def _at_scene_fault(reference: requests.SceneReference) -> Iterator[None]:
    if isinstance(reference, RequestScene) and reference.base is not None:
        with _at_added_fault(reference.add):
            yield
    elif isinstance(reference, str):
        try:
            yield
        except SceneInvalid as error:
            error.details.pop("path", None)
            raise
    else:
        yield


@contextlib.contextmanager
def _at_added_fault(coming: Sequence[Obstacle]) -> Iterator[None]:
    try:
        yield
    except SceneInvalid as error:
        index = next((k for k, one in enumerate(coming) if one.name == error.details.get("obstacle")), None)
        _, among, field = str(error.details.get("path", "")).partition("$.obstacles[")
        if among and index is not None:
            error.details["path"] = f"$.add[{index}]{field.partition(']')[2]}"
        raise


class _RobotLoader:
    """Loads the robot of a request once, so that its files aren't checked for changes again."""

    def __init__(
        self, find: Callable[[requests.RobotReference], requests.RobotReference | SentRobot], loaded: SharedCaches
    ) -> None:
        self._find, self._loaded = find, loaded
        self._known: tuple[requests.RobotReference, requests.RobotReference | SentRobot, RobotModel] | None = None

    def __call__(self, reference: requests.RobotReference) -> RobotModel:
        if self._known is None or self._known[0] is not reference:
            with at_path("$.robot"):
                found = self._find(reference)
                self._known = reference, found, self._loaded.catalog.load(found)
        return self._known[2]

    def origin(self) -> RobotOrigin:
        from guidefield.run_log import RobotOrigin

        assert self._known is not None, "it was loaded"
        return RobotOrigin(*self._loaded.catalog.origin(self._known[1]), self._loaded.packages)


_default = functools.cache(Engine)


def answer(
    request: bytes | str | dict[str, Any] | requests.Request,
    *,
    record_to: str | Path | None = None,
    proof_to: str | Path | None = None,
) -> Reply:
    """Answer one request in this process, as the service does, without its queue and stores.

    The first call of a process loads the planner; the first one of a version compiles its kernels, for about a minute.

    Args:
        request: A plan, a motion to certify, a kinematics request, or any other that the service answers: a message
            such as `PlanRequest`, the same as a dict, or its JSON. One without a ``type`` is a plan request. It may
            contain NumPy's numbers and arrays.
        record_to: File of the recording of a plan or verdict (`.rrd`), if any.
        proof_to: Where to write the proof that its motion is free (`.npz`), if anywhere.

    Returns:
        The reply to the request's kind: of a plan a `PlanReply`, of a judgement a `CertifyReply`. A plan that was not
        found and a motion that is refused are replies too; their `status` says why.

    Raises:
        GuidefieldError: if the request is ill-posed. Each kind of fault has its own exception, the one that the service
            would send as ``reply_err``: `MalformedRequest`, `RobotInvalid`, `SceneInvalid`, `InvalidGoal` and so on.

    Examples:
        >>> import guidefield
        >>> goal = {"type": "joints", "positions": {"elbow_joint": 1.2}}
        >>> request = {"robot": "ur5", "scene": "table", "goal": goal, "guide_planes": []}
        >>> reply = guidefield.answer(request)
        >>> reply.status.name, reply.certificate.collision_free
        ('SUCCESS', True)

        A question that is ill-posed raises, and says what would be right:

        >>> guidefield.answer({**request, "robot": "ur55"})
        Traceback (most recent call last):
        guidefield.errors.RobotInvalid: there is no robot 'ur55'; did you mean ur5? ...
    """
    came = time.monotonic()
    recording, proof = (None if place is None else Path(place) for place in (record_to, proof_to))
    return _default().answer(read_request(request), record_to=recording, proof_to=proof, came=came)


def motions_of(request: requests.CertifyRequest) -> list[Motion]:
    """Return the parts of a certify request's motion, for the referee's file; GuidefieldError if it is ill-posed."""
    return _default().motions_of(request)
