"""Proofs of certified motions: the referee replays each, and refuses it changed wherever that makes a false claim.

A change in a file whose digest stays is always refused. Sealed anew, a changed proof may still be one: then what it
claims has to be true. It may keep no more than the smallest distances that the certificate has measured, and the
referee, judging by distances alone, may find nothing against what it is about.
"""

from __future__ import annotations

import json
import math
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from doubting.compare import OFF, Disagreement, Kind
from doubting.loaded import Loaded
from doubting.refereed import contradicts
from guidefield.case_file import pack_arrays
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest
from guidefield.prove.verdict import Reason
from guidefield.referee.case import Answer, Verdict
from guidefield.referee.judge import judge
from guidefield.referee.loading import UnusableFile, case_of
from guidefield.referee.replay import replay_file

CHANGES = 16
"""Changes of one proof, at most."""
CHANGES_SECONDS = 20.0
"""No change is begun after this much processor time: replaying a robot of many triangles takes seconds [s]."""
SECONDS = 3.0
"""Time in which the referee looks for what speaks against a changed motion [s]."""
AGAINST = (Answer.CONTACT, Answer.TOO_CLOSE, Answer.INSIDE, Answer.BEYOND_LIMIT)
"""Answers that speak against a motion."""
DECLARED = re.compile(r'(radius|length|size)="([^"]+)"')
"""Lengths of primitives in a URDF."""

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Proved:
    """A motion with its proof.

    Attributes:
        arrays: Those of the file.
        least: The smallest room beyond what is required that was measured [m]; infinite if nothing was.
        obstacles: The smallest distance from obstacles that was measured [m]; infinite if there are none.
        own: The same of the robot from itself.
    """

    arrays: Arrays
    least: float
    obstacles: float
    own: float

    def case(self) -> dict[str, Any]:
        """The case that it is about, to be changed."""
        return {**json.loads(self.arrays["cases"].tobytes())[0]}

    def about(self, case: dict[str, Any]) -> Arrays:
        """The proof as one about another case."""
        return {**self.arrays, "cases": np.frombuffer(json.dumps([case]).encode(), np.uint8)}


Change = Callable[[np.random.Generator, Proved, Sequence[Proved]], Arrays | None]
"""Changes a proof; None where that can't be done with it."""


def doubt_proof(
    rng: np.random.Generator, loaded: Loaded, request: CertifyRequest, reply: CertifyReply, earlier: list[Proved]
) -> tuple[Counter[str], list[Disagreement]]:
    """Prove a motion that is certified free and within its limits, replay the proof, and change it.

    Args:
        rng: Draws the changes.
        loaded: The robot.
        request: The motion.
        reply: The verdict about it.
        earlier: Proofs for the same robot, of which others' motions are taken; this one is added.

    Returns:
        How many proofs were replayed, and changed ones refused or right all the same; what contradicts a proof.
    """
    counts, found = Counter[str](), list[Disagreement]()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "proof.npz")
        answered = loaded.engine.answer(request, proof_to=file)
        if not isinstance(answered, CertifyReply) or answered.proof is None:
            warnings = getattr(answered, "warnings", [f"{answered}"])
            # a proof is about the whole scene, whose rounding is larger than that of what is within reach
            untold = isinstance(answered, CertifyReply) and answered.certificate.reason == Reason.UNDECIDED.value
            if untold or any("no proof is kept: time was up" in warning for warning in warnings):
                counts["proof:undecided"] += 1
                return counts, []
            return counts, [Disagreement(Kind.PROOF, f"there is none: {warnings}")]
        one = Proved(_read(file), *_measured(reply, request))
        counts["proof:replayed"] += 1
        _, verdict, why = _replayed(file, one.arrays)
        if verdict is None or (why := _false(one, one.arrays, verdict)):
            return counts, [Disagreement(Kind.PROOF, f"it is replayed, but {why}" if verdict else why)]
        found += _doubt_digest(rng, file, one.arrays)
        until = time.process_time() + CHANGES_SECONDS
        for number in range(CHANGES):
            if time.process_time() > until:
                break
            change = CHANGES_OF_CLAIMS[number] if number < len(CHANGES_OF_CLAIMS) else _drawn(rng)
            changed = change(rng, one, earlier)
            if changed is None:
                continue
            state, verdict, why = _replayed(file, changed)
            counts[f"proof:changed and {state}"] += 1
            if verdict is not None:
                why = "it is false" if change in CHANGES_OF_CLAIMS else _false(one, changed, verdict)
            if why and state != "refused":
                found.append(Disagreement(Kind.PROOF, f"after {change.__name__}: {why}"))
    earlier.append(one)
    return counts, found


def _measured(reply: CertifyReply, request: CertifyRequest) -> tuple[float, float, float]:
    """See `Proved`: `least`, `obstacles` and `own`."""
    obstacle, own = reply.clearance and reply.clearance.minimum, reply.self_clearance and reply.self_clearance.minimum
    obstacle, own = math.inf if obstacle is None else obstacle, math.inf if own is None else own
    return min(obstacle - request.min_clearance, own), obstacle, own


def _read(file: Path) -> Arrays:
    with np.load(file) as read_back:
        return {name: read_back[name] for name in read_back.files if name not in ("format", "digest")}


def _doubt_digest(rng: np.random.Generator, file: Path, arrays: Arrays) -> list[Disagreement]:
    """One bit anywhere is another, and the digest is as it was."""
    name = _some(rng, [name for name, array in arrays.items() if array.nbytes])
    with np.load(file) as read_back:
        whole = {one: read_back[one] for one in read_back.files}
    content = bytearray(whole[name].tobytes())
    content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
    whole[name] = np.frombuffer(bytes(content), whole[name].dtype).reshape(whole[name].shape)
    np.savez(file, **whole)
    try:
        replay_file(file, SECONDS)
    except (UnusableFile, UnicodeDecodeError):
        return []
    return [Disagreement(Kind.PROOF, f"a bit of {name} is another, and the file is read")]


def _replayed(file: Path, arrays: Arrays) -> tuple[str, Verdict | None, str]:
    """Replay a proof that is sealed: what comes of it in a word, the verdict where it holds, else why it doesn't."""
    file.write_bytes(pack_arrays(arrays))
    try:
        (verdict,) = replay_file(file, SECONDS)
    except UnusableFile as error:
        return "refused", None, f"{error}"
    except Exception as error:  # whatever is in a file, the referee has to end with a verdict
        return "crashed", None, f"the referee ends with {type(error).__name__}: {error}"
    return ("right", verdict, "") if verdict.answer is Answer.FREE else ("refused", None, f"{verdict.finding}")


def _false(one: Proved, arrays: Arrays, verdict: Verdict) -> str:
    """Say what speaks against a proof that is replayed."""
    if arrays["cases"] is one.arrays["cases"]:
        return "" if verdict.kept <= one.least + OFF else f"{verdict.kept:g} m are kept, and {one.least:g} m measured"
    case = case_of(json.loads(arrays["cases"].tobytes())[0])
    against = judge(case, seconds=SECONDS)
    is_false = against.answer in AGAINST and contradicts(against.finding, case.clearance)
    return f"the referee's judge says {against.finding}" if is_false else ""


def _some(rng: np.random.Generator, among: Sequence[Any]) -> Any:
    return among[int(rng.integers(len(among)))]


def _drawn(rng: np.random.Generator) -> Change:
    return _some(rng, CHANGES_OF_RECORDS)


def more_clearance(_: np.random.Generator, one: Proved, __: Sequence[Proved]) -> Arrays | None:
    """Ask for a clearance that isn't kept."""
    if not math.isfinite(one.obstacles):
        return None
    return one.about(one.case() | {"min_clearance": one.obstacles + OFF})


def more_claimed(_: np.random.Generator, one: Proved, __: Sequence[Proved]) -> Arrays | None:
    """Claim that everything keeps more than it does."""
    if not math.isfinite(one.least):
        return None
    claims = [(-1e9, 1e9, 0.0, one.obstacles + OFF), (-1e9, 1e9, 1.0, one.own + OFF)]
    claims = [claim for claim in claims if math.isfinite(claim[3])]
    return {**one.arrays, "0/claims": np.array(claims)}


def another_number(rng: np.random.Generator, one: Proved, _: Sequence[Proved]) -> Arrays | None:
    """Change one number anywhere, by little or much."""
    name = _some(rng, [name for name, array in one.arrays.items() if array.size and array.dtype.kind in "if"])
    array = one.arrays[name].copy()
    at = np.unravel_index(int(rng.integers(array.size)), array.shape)
    if name == "cases":
        return None
    if array.dtype.kind == "i":
        array[at] += int(_some(rng, [-1, 1, int(rng.integers(-9, 10))]))
    else:
        array[at] = array[at] * (1.0 + rng.normal() * 10.0 ** rng.uniform(-6.0, 0.5)) + rng.normal() * 1e-6
    return {**one.arrays, name: array}


def dropped_slab(rng: np.random.Generator, one: Proved, _: Sequence[Proved]) -> Arrays | None:
    """Leave slabs out, one or many."""
    count = len(one.arrays["0/slab_segments"])
    if not count:
        return None
    return _slabs(one, np.flatnonzero(rng.random(count) > _some(rng, [0.5 / count, 1.5 / count, 0.3])))


def swapped_slabs(rng: np.random.Generator, one: Proved, _: Sequence[Proved]) -> Arrays | None:
    """Exchange what two slabs have: directions, nodes or segments."""
    count, name = len(one.arrays["0/slab_segments"]), _some(rng, SLABS)
    if count < 2:
        return None
    first, second = rng.choice(count, 2, replace=False).tolist()
    array = one.arrays[name].copy()
    array[[first, second]] = array[[second, first]]
    return {**one.arrays, name: array}


def dropped_segment(rng: np.random.Generator, one: Proved, _: Sequence[Proved]) -> Arrays | None:
    """Leave a segment out, with its slabs."""
    gone = int(rng.integers(len(one.arrays["0/segments"])))
    of_slabs = one.arrays["0/slab_segments"]
    kept = _slabs(one, np.flatnonzero(of_slabs != gone))
    left = kept["0/slab_segments"]
    shifted = left - (left > gone).astype(left.dtype)
    return {**kept, "0/segments": np.delete(one.arrays["0/segments"], gone, axis=0), "0/slab_segments": shifted}


def stretched_segment(rng: np.random.Generator, one: Proved, _: Sequence[Proved]) -> Arrays | None:
    """Let a segment begin earlier or end later, with its slabs as they are."""
    segments = one.arrays["0/segments"].copy()
    at, side = int(rng.integers(len(segments))), int(rng.integers(2))
    segments[at, side] += (2 * side - 1) * np.ptp(segments[at]) * 10.0 ** rng.uniform(-3.0, 0.3)
    return {**one.arrays, "0/segments": segments}


def slabs_of_a_part(rng: np.random.Generator, one: Proved, _: Sequence[Proved]) -> Arrays | None:
    """Say of all slabs of a segment that they are those of another one, which contains it or not."""
    segments = one.arrays["0/slab_segments"].copy()
    if not len(segments):
        return None
    segments[segments == _some(rng, segments)] = int(rng.integers(len(one.arrays["0/segments"])))
    return {**one.arrays, "0/slab_segments": segments}


def smaller_shapes(rng: np.random.Generator, one: Proved, _: Sequence[Proved]) -> Arrays | None:
    """Shrink what is said to hold the bodies."""
    share = 1.0 - 10.0 ** rng.uniform(-4.0, -0.3)
    numbers = one.arrays["0/shape_numbers"].copy()
    numbers[:, :2] *= np.where(np.isinf(numbers[:, :1]), 1.0, share)
    return {**one.arrays, "0/shape_numbers": numbers, "0/corners": one.arrays["0/corners"] * np.float32(share)}


def motion_of_another(rng: np.random.Generator, one: Proved, earlier: Sequence[Proved]) -> Arrays | None:
    """Put another plan's motion into the case, or this plan's with other knots."""
    case = one.case()
    if earlier and rng.random() < 0.5:
        other = _some(rng, earlier).case()
        if other["motion"]["joints"] != case["motion"]["joints"]:
            return None
        return one.about(case | {"motion": other["motion"]})
    motion = case["motion"]
    positions = np.array(motion["positions"])
    positions += rng.normal(size=positions.shape) * 10.0 ** rng.uniform(-4.0, 0.0)
    return one.about(case | {"motion": motion | {"positions": positions.tolist()}})


def other_robot(rng: np.random.Generator, one: Proved, _: Sequence[Proved]) -> Arrays | None:
    """Make the links larger."""
    share, case = 1.0 + 10.0 ** rng.uniform(-4.0, 0.0), one.case()

    def scaled(match: re.Match[str]) -> str:
        return f'{match[1]}="{" ".join(str(share * float(number)) for number in match[2].split())}"'

    urdf = DECLARED.sub(scaled, case["robot"]["urdf"])
    return None if urdf == case["robot"]["urdf"] else one.about(case | {"robot": case["robot"] | {"urdf": urdf}})


def moved_obstacle(rng: np.random.Generator, one: Proved, _: Sequence[Proved]) -> Arrays | None:
    """Put an obstacle elsewhere."""
    case = one.case()
    moved = [k for k, told in enumerate(case["obstacles"]) if "position" in told]
    if not moved:
        return None
    k = _some(rng, moved)
    obstacle = case["obstacles"][k]
    shift = rng.normal(size=3) * 10.0 ** rng.uniform(-4.0, 0.0)
    obstacle = obstacle | {"position": (np.array(obstacle["position"], float) + shift).tolist()}
    return one.about(case | {"obstacles": [*case["obstacles"][:k], obstacle, *case["obstacles"][k + 1 :]]})


def _slabs(one: Proved, kept: np.ndarray) -> Arrays:
    """A proof with some of its slabs alone."""
    return {**one.arrays, **{name: one.arrays[name][kept] for name in SLABS}}


SLABS = ("0/slab_segments", "0/slab_nodes", "0/slab_axes")
CHANGES_OF_CLAIMS: tuple[Change, ...] = (more_clearance, more_claimed)
"""Changes by which a proof claims what is false."""
CHANGES_OF_RECORDS: tuple[Change, ...] = (
    another_number,
    another_number,
    dropped_slab,
    swapped_slabs,
    dropped_segment,
    stretched_segment,
    slabs_of_a_part,
    smaller_shapes,
    motion_of_another,
    other_robot,
    moved_obstacle,
)
"""Other changes, after which a proof may be right by chance."""
