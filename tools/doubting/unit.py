"""A unit of work: a robot, plans for it and changed motions of each, or aligned motions; the same for the same seed."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np

from doubting import aligned, mutants, robots, sized
from doubting.asked import draw_plan
from doubting.case import Case, Request, find_contradictions, shrink
from doubting.doubted import Doubted, doubt_answer
from doubting.judge import Sampled
from doubting.loaded import Loaded
from doubting.proofs import Proved, doubt_proof
from doubting.refereed import Outcome, ask_hpp, ask_referee
from doubting.tally import Unit, commit
from guidefield.engine import Engine
from guidefield.errors import GuidefieldError
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest, PlanRequest

PLANS = 20
"""Plans for one robot."""
MUTANTS = 12
"""Changed motions of one certified plan."""
ALIGNED, ALIGNED_REFEREED = 200, 200
"""Motions with exact symmetries of one arm; of so many one is put before the referee."""
FOUND = "found"
"""Folder of disagreements, below that of a run."""
PLANS_REFEREED, MUTANTS_REFEREED = 18, 42
"""Of so many one is put before the referee; of changed motions also each that is refused where samples see room."""
ROOM = 2e-4
"""Samples at least this far apart see room [m]."""
MOST_SHRUNK = 3
"""So many of a unit are made smaller; the others have the same cause, mostly."""
NEAR = (1e-6, 1e-5, 1e-4, 1e-3)
"""Margins are counted by these [m]."""


class Work:
    """A unit that is worked at."""

    def __init__(self, seed: int, folder: Path, engine: Engine | None = None) -> None:
        self.seed, self.folder = seed, folder
        self.counts: Counter[str] = Counter()
        self.files: list[str] = []
        self.engine = Engine() if engine is None else engine
        self.proofs: list[Proved] = []

    def done(self, plans: int = PLANS, changed: int = MUTANTS, motions: int = ALIGNED) -> Unit:
        """Do it: every second unit judges motions with exact symmetries."""
        if self.seed % 2:
            return self.aligned(motions)
        began = time.monotonic()
        robot = robots.draw_robot(np.random.default_rng([self.seed]))
        loaded = self._load(robot, "robot")
        if loaded is None:
            return self._ended(began)
        if not loaded.movable:
            self.counts["left out:robot that can't move"] += 1
            return self._ended(began)
        self.counts[f"robot:{robot.catalog or ('with meshes' if robot.meshes else 'random')}"] += 1
        size, larger = sized.drawn_size(np.random.default_rng([self.seed, 3]), robot), loaded
        if size != 1.0:
            self.counts[f"size:{'smaller' if size < 1.0 else 'larger'}"] += 1
            larger = self._load(sized.sized_robot(robot, size), "sized robot")
            if larger is None:
                return self._ended(began)
        for index in range(plans):
            self._plan(loaded, index, changed, larger, size)
        return self._ended(began)

    def aligned(self, motions: int = ALIGNED) -> Unit:
        """Motions with exact symmetries, by one arm."""
        began, rng = time.monotonic(), np.random.default_rng([self.seed, 1])
        loaded = self._load(aligned.arm(rng), "robot")
        if loaded is None:
            return self._ended(began)
        self.counts["robot:aligned"] += 1
        for index in range(motions):
            one = aligned.draw_motion(np.random.default_rng([self.seed, 1, index]), loaded)
            if one is None:
                self.counts["left out:no gap"] += 1
                continue
            asked_too = (self.seed // 2 + index) % ALIGNED_REFEREED == 0
            self.counts[f"aligned:{one.kind}"] += 1
            self._mutant(loaded, "aligned", one.request, f"seed {self.seed}, aligned {index}, {one.kind}", asked_too)
        return self._ended(began)

    def _load(self, robot: robots.Robot, what: str) -> Loaded | None:
        """Load a robot; None if the service refuses it, which is counted."""
        try:
            return Loaded.of(robot, self.folder / "robots", self.engine)
        except GuidefieldError as error:
            self.counts[f"left out:{what} {type(error).__name__}"] += 1
            return None

    def _ended(self, began: float) -> Unit:
        return Unit(self.seed, time.monotonic() - began, dict(self.counts), self.files, commit())

    def _plan(self, drawn: Loaded, index: int, changed: int, loaded: Loaded, size: float) -> None:
        """Doubt a plan that is drawn for one robot, by the one that is so many times as large."""
        rng = np.random.default_rng([self.seed, index])
        one = draw_plan(rng, drawn, index)
        if one is None:
            self.counts["left out:no free ends"] += 1
            return
        if np.random.default_rng([self.seed, index, 4]).random() < sized.MESHED:
            self.counts["plan:among meshes"] += 1
            one = dataclasses.replace(one, request=sized.in_meshes(one.request))
        if size != 1.0:
            one = dataclasses.replace(one, request=sized.sized_request(one.request, size, loaded))
        came = doubt_answer(loaded, one.request)
        origin = f"seed {self.seed}, plan {index}, {one.kind}"
        self._note(loaded, one.request, came, origin)
        if came.reply is None:
            return
        self._count_plan(loaded, one.kind, one.request, came)
        motion, free = came.reply.trajectory, came.reply.certificate.collision_free
        if motion is None or not free or came.sampled is None or came.judge is None:
            return
        if one.request.leave_start_contact and " after " in came.reply.certificate.covers:
            return
        base = mutants.base_of(loaded, one.request, came.reply, came.sampled, came.judge)
        self._geared(rng, loaded, base.request, origin)
        for number, (kind, request) in enumerate(mutants.draw_mutants(rng, base, changed)):
            if number == 0:
                asked_too = (self.seed + index) % PLANS_REFEREED == 0
            else:
                asked_too = (self.seed + 7 * index + number) % MUTANTS_REFEREED == 0
            self._mutant(loaded, kind, request, f"{origin}, mutant {number}, {kind}", asked_too)

    def _mutant(self, loaded: Loaded, kind: str, request: CertifyRequest, origin: str, asked_too: bool) -> None:
        came = doubt_answer(loaded, request)
        if isinstance(came.reply, CertifyReply) and (asked_too or _refused_with_room(came, request)):
            came = self._refereed(loaded, kind, request, came)
        self._note(loaded, request, came, origin)
        if came.reply is None:
            return
        self.counts["mutants"] += 1
        self.counts[f"mutant:{kind.partition('+')[0]}"] += 1
        self.counts[f"verdict:{came.reply.certificate.reason}"] += 1
        state = "undecided" if came.untold else "certified" if came.reply.certificate.collision_free else "refused"
        self.counts[f"mutants {state}"] += 1
        if came.sampled is not None:
            self._count_near(came.sampled, request.min_clearance)

    def _geared(self, rng: np.random.Generator, loaded: Loaded, request: CertifyRequest, origin: str) -> None:
        """The motion by a robot one of whose mimic joints has another multiplier; once for a robot."""
        other = robots.change_gear(rng, loaded.robot)
        if other is None or "mutant:geared" in self.counts:
            return
        changed = self._load(other, "geared robot")
        if changed is None:
            return
        request = msgspec.structs.replace(request, robot=changed.reference)
        self._mutant(changed, "geared", request, f"{origin}, geared", asked_too=True)

    def _refereed(self, loaded: Loaded, kind: str, request: CertifyRequest, came: Doubted) -> Doubted:
        """The same with what the referee and HPP say."""
        outcome, found = ask_referee(request, came.reply)
        if outcome is not Outcome.NOT_ASKED:
            self.counts["referee plans" if kind == "same" else "referee mutants"] += 1
            self.counts[f"referee:{outcome}"] += 1
            self.counts[f"referee {outcome}"] += outcome in (Outcome.UNDECIDED, Outcome.NOT_JUDGED)
        if came.reply.status.name == "SUCCESS" and " after " not in came.reply.certificate.covers:
            counts, wrong = doubt_proof(np.random.default_rng([self.seed, 2]), loaded, request, came.reply, self.proofs)
            self.counts.update(counts)
            found = [*found, *wrong]
        heard, more = ask_hpp(loaded, request, came.reply)
        self.counts[f"hpp:{heard}"] += heard is not Outcome.NOT_ASKED
        return dataclasses.replace(came, found=(*came.found, *found, *more))

    def _count_plan(self, loaded: Loaded, kind: str, request: PlanRequest, came: Doubted) -> None:
        counts = self.counts
        counts["plans"] += 1
        counts[f"plan:{kind}"] += 1
        counts[f"status:{came.reply.status.name}"] += 1
        counts["plans sampled"] += came.sampled is not None
        for joint in {str(joint.kind) + " follower" * (joint.mimic is not None) for joint in loaded.model.joints}:
            counts[f"joint:{joint}"] += 1
        for shape in {type(one).__name__ for one in request.scene.obstacles}:
            counts[f"obstacle:{shape}"] += 1
        counts["obstacle:moving"] += any(one.trajectory is not None for one in request.scene.obstacles)
        counts["obstacle:held"] += bool(request.attached_objects)
        if came.sampled is not None:
            self._count_near(came.sampled, request.min_clearance)

    def _count_near(self, sampled: Sampled, min_clearance: float) -> None:
        margin = min(abs(sampled.obstacle.distance - min_clearance), abs(sampled.own.distance))
        for bound in NEAR:
            if margin < bound:
                self.counts[f"near:within {1e6 * bound:g} um of the border"] += 1
                return

    def _note(self, loaded: Loaded, request: Request, came: Doubted, origin: str) -> None:
        """Count what was refused; shrink and keep what is contradicted."""
        if came.refused is not None:
            self.counts[f"left out:{type(request).__name__} {came.refused}"] += 1
        if not came.found:
            return
        self.counts["disagreements"] += 1
        small, said = request, came.found
        if len(self.files) < MOST_SHRUNK:
            small = shrink(loaded, request, came.found[0].kind)
            said = find_contradictions(loaded, small) or came.found
        (self.folder / FOUND).mkdir(parents=True, exist_ok=True)
        name = origin.replace("seed ", "").replace(", ", "-").replace(" ", "")
        file = self.folder / FOUND / f"{name}.json"
        Case(loaded.robot, small, tuple(f"{one.kind}: {one.said}" for one in said), origin).write(file)
        self.files.append(f"{FOUND}/{file.name}")


def _refused_with_room(came: Doubted, request: CertifyRequest) -> bool:
    """Return whether a motion is refused though no sample is close to what is required."""
    if came.sampled is None or came.judge is None or came.reply.certificate.collision_free or came.judge.moves:
        return False
    both = (came.sampled.obstacle, request.min_clearance), (came.sampled.own, 0.0)
    return min(one.distance - one.slack - kept for one, kept in both) > ROOM


def work(seed: int, folder: Path) -> Unit:
    """Do a unit, in a process of its own."""
    logging.disable(logging.CRITICAL)
    return Work(seed, folder).done()
