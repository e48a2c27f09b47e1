"""Proofs that are replayed: certified motions of all kinds hold, planted faults and changed numbers don't."""

import dataclasses
import zipfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.interpolate import BPoly

from guidefield import CertifyRequest, PlanRequest, case_file
from guidefield.case_file import arrays_of, curve_of, pack_arrays, write_proof
from guidefield.engine import Engine, motions_of
from guidefield.prove.proof import Proof, prove
from guidefield.prove.search import SearchQuery
from guidefield.referee import motion_bounds, proof as proofs, replay as replays
from guidefield.referee.__main__ import main
from guidefield.referee.case import Answer, Case
from guidefield.referee.judge import Along
from guidefield.referee.loading import UnusableFile
from guidefield.referee.motion_bounds import SegmentBounds
from guidefield.referee.proof import load_proofs, proof_of
from guidefield.referee.replay import replay, replay_file
from tests.referee.cases import planned, read
from tests.referee.drawn import draw


def proved(motion: case_file.Motion) -> Proof | None:
    curve = curve_of(motion)
    span = float(curve.times[0]), float(curve.times[-1])
    goal = SearchQuery(motion.min_clearance)
    if curve.tube is None:
        goal = SearchQuery(motion.min_clearance, spans=[span], samples=np.linspace(*span, 20))
    return prove(motion.world, curve, goal)[1]


def replayed(case: Case, proof: Proof, **changed: np.ndarray) -> Answer:
    """Replay what the arrays of a proof tell, with some of them changed."""
    return replay(case, proof_of({**arrays_of(proof), **changed})).answer


def certain(moving: bool, count: int, executed: bool = False) -> list[tuple[Case, Proof]]:
    """Cases that are proved, drawn one after the other."""
    found: list[tuple[Case, Proof]] = []
    seed = 0
    while len(found) < count:
        drawn, seed = draw(np.random.default_rng([seed, moving, *[7] * executed]), moving, executed), seed + 1
        proof = proved(drawn.motion)
        if proof is not None:
            case = read(drawn.motion, limits=False)
            if replay(case, proof).answer is not Answer.INSIDE:
                found.append((case, proof))
    return found


@pytest.fixture(scope="module", params=[False, True], ids=["at rest", "moving"])
def cases(request: pytest.FixtureRequest) -> list[tuple[Case, Proof]]:
    return certain(request.param, 8)


@pytest.fixture(scope="module", params=[False, True], ids=["at rest", "moving"])
def executed(request: pytest.FixtureRequest) -> list[tuple[Case, Proof]]:
    return certain(request.param, 12, executed=True)


def test_segments_that_end_before_they_begin_are_told(cases: list[tuple[Case, Proof]]) -> None:
    case, proof = cases[0]
    backwards = proof.segments.copy()
    backwards[-1] = backwards[-1, ::-1]
    with pytest.raises(UnusableFile, match="contradicts itself"):
        replayed(case, proof, segments=backwards)


@pytest.mark.parametrize("child", [-2, 10**9])
def test_a_child_that_is_none_is_told(cases: list[tuple[Case, Proof]], child: int) -> None:
    case, proof = cases[0]
    children = proof.node_children.copy()
    children[0] = 1, child
    with pytest.raises(UnusableFile, match="contradicts itself"):
        replayed(case, proof, node_children=children)


def test_proofs_of_certified_motions_hold(cases: list[tuple[Case, Proof]]) -> None:
    assert sum(len(proof.slab_segments) for _, proof in cases) > 60
    for case, proof in cases:
        verdict = replay(case, proof)
        assert verdict.answer is Answer.FREE, verdict
        assert verdict.kept > 0.0


def test_a_larger_clearance_isnt_proved(cases: list[tuple[Case, Proof]]) -> None:
    for case, proof in cases:
        kept = replay(case, proof).kept
        if np.isfinite(kept):
            more = dataclasses.replace(case, clearance=case.clearance + kept + 1e-4)
            claims = np.array([[-1e9, 1e9, 1.0, kept + 1e-4]])
            assert Answer.NOT_PROVED in (replay(more, proof).answer, replayed(case, proof, claims=claims))


def test_no_segment_can_be_left_out(cases: list[tuple[Case, Proof]]) -> None:
    for case, proof in [some for some in cases if len(some[1].segments) > 1][:4]:
        begins, count = proof.segments[:, 0], len(proof.segments)
        leaves = [
            k
            for k in range(count)
            if not ((begins >= begins[k]) & (proof.segments[:, 1] <= proof.segments[k, 1])).sum() > 1
        ]
        for k in leaves[:: max(1, len(leaves) // 6)]:
            kept = proof.slab_segments != k
            shifted = proof.slab_segments - (proof.slab_segments > k)
            changed = {
                "slab_segments": shifted[kept],
                "slab_nodes": proof.slab_nodes[kept],
                "slab_axes": proof.slab_axes[kept],
            }
            assert replayed(case, proof, segments=np.delete(proof.segments, k, axis=0), **changed) is Answer.NOT_PROVED


def test_no_slab_that_a_pair_needs_can_be_left_out(cases: list[tuple[Case, Proof]]) -> None:
    refused = tried = 0
    for case, proof in cases:
        for k in range(0, len(proof.slab_segments), max(1, len(proof.slab_segments) // 4)):
            kept = np.arange(len(proof.slab_segments)) != k
            names = ("slab_segments", "slab_nodes", "slab_axes")
            answer = replayed(case, proof, **{name: getattr(proof, name)[kept] for name in names})
            refused, tried = refused + (answer is Answer.NOT_PROVED), tried + 1
    assert refused > 0.9 * tried  # else its pair is told apart in another way too


def parents_of(segments: np.ndarray) -> list[int]:
    """The shortest segment around each, -1 without one."""
    found = []
    for begin, end in segments.tolist():
        around = np.flatnonzero(
            (segments[:, 0] <= begin) & (segments[:, 1] >= end) & (np.ptp(segments, axis=1) > end - begin)
        )
        found.append(int(around[np.argmin(np.ptp(segments[around], axis=1))]) if len(around) else -1)
    return found


def leave_second_order_out(monkeypatch: pytest.MonkeyPatch) -> None:
    right = SegmentBounds._bound
    monkeypatch.setattr(
        SegmentBounds, "_bound", lambda *args: (bound := right(*args))._replace(bent=np.zeros_like(bound.bent))
    )


def halve_the_sweep(monkeypatch: pytest.MonkeyPatch) -> None:
    right = motion_bounds.bound_chords

    def halved(*args: Any, **kwargs: Any) -> motion_bounds.ChordBounds:
        found = right(*args, **kwargs)
        return found._replace(shares=0.5 * found.shares, farthest=0.5 * found.farthest, sideways=0.5 * found.sideways)

    monkeypatch.setattr(motion_bounds, "bound_chords", halved)


def stop_climbing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the second corner for the farthest one, where there is one."""
    right = replays.Slabs._support

    def stopped(self: replays.Slabs, shape: np.ndarray, d: np.ndarray) -> np.ndarray:
        begins = self._shapes.begins
        found = right(self, shape, d)
        near = self._shapes.corners[np.minimum(begins[shape] + 1, begins[shape + 1] - 1)]
        return np.minimum(found, (near * d).sum(axis=1))

    monkeypatch.setattr(replays.Slabs, "_support", stopped)


def look_at_one_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replays, "ENDS", (1.0,))


@pytest.mark.parametrize("plant", [leave_second_order_out, halve_the_sweep, stop_climbing, look_at_one_end])
def test_slabs_of_a_search_with_a_fault_arent_true(cases, plant):
    """A slab of one half of a segment is put into the whole, where the fault lets it pass; the referee refuses it."""
    found = 0
    for case, proof in cases:
        above = parents_of(proof.segments)
        for k, segment in enumerate(proof.slab_segments[:60].tolist()):
            if above[segment] < 0:
                continue
            wrong = {
                "slab_segments": np.append(proof.slab_segments, np.int32(above[segment])),
                "slab_nodes": np.vstack([proof.slab_nodes, proof.slab_nodes[k]]),
                "slab_axes": np.vstack([proof.slab_axes, proof.slab_axes[k]]),
            }
            if replayed(case, proof, **wrong) is Answer.NOT_PROVED:
                with pytest.MonkeyPatch.context() as patched:
                    plant(patched)
                    found += replayed(case, proof, **wrong) is Answer.FREE
            if found >= 1:
                return
    pytest.fail(f"{found} slabs pass with that fault")


def _between_bodies(proof: Proof) -> np.ndarray:
    """Slabs across directions that are told; a half-space has one of its own."""
    shapes = proof.node_shapes[proof.slab_nodes[:, 1], 1]
    return np.flatnonzero(proof.slab_axes.any(axis=1) & np.isfinite(proof.shape_numbers[shapes, 0]))


def _reversed_axis(arrays: dict[str, np.ndarray], row: int) -> None:
    arrays["slab_axes"][row] *= -1.0


def _claimed_more(arrays: dict[str, np.ndarray], _: int) -> None:
    arrays["claims"] = np.array([[-1e9, 1e9, 0.0, 10.0], [-1e9, 1e9, 1.0, 10.0]])


def _smaller_shape(arrays: dict[str, np.ndarray], row: int) -> None:
    shape = arrays["node_shapes"][arrays["slab_nodes"][row, 0]].max()
    some = slice(*arrays["shape_begins"][shape : shape + 2])
    middle = arrays["corners"][some].mean(axis=0)
    arrays["corners"][some] = middle + 0.9 * (arrays["corners"][some] - middle)
    arrays["shape_numbers"][shape, :2] *= 0.9


def _moved_origin(arrays: dict[str, np.ndarray], row: int) -> None:
    arrays["origins"][arrays["node_bodies"][arrays["slab_nodes"][row, 0]]] += 0.01


def _other_body(arrays: dict[str, np.ndarray], row: int) -> None:
    arrays["numbers"][arrays["node_bodies"][arrays["slab_nodes"][row, 1]]] += 1


def _gap(arrays: dict[str, np.ndarray], row: int) -> None:
    arrays["segments"][arrays["slab_segments"][row], 1] -= 1e-9


@settings(max_examples=12)
@given(
    st.integers(0, 10**6),
    st.integers(0, 10**6),
    st.sampled_from([_reversed_axis, _claimed_more, _smaller_shape, _moved_origin, _other_body, _gap]),
)
def test_a_changed_number_is_refused(cases, which, row, change):
    """Whoever seals a changed proof anew has to keep every slab true, all bodies held, and no gap."""
    some = [(case, proof) for case, proof in cases if len(_between_bodies(proof))]
    case, proof = some[which % len(some)]
    rows = _between_bodies(proof)
    arrays = {name: array.copy() for name, array in arrays_of(proof).items()}
    change(arrays, int(rows[row % len(rows)]))
    assert replay(case, proof_of(arrays)).answer is Answer.NOT_PROVED


def test_a_file_in_which_a_bit_is_another_is_refused(tmp_path: Path, capsys: Any, monkeypatch: Any) -> None:
    motion = next(m for m in (draw(np.random.default_rng([s, 0]), False).motion for s in range(99)) if proved(m))
    file = tmp_path / "proof.npz"
    write_proof(file, motion)
    monkeypatch.setattr("sys.argv", ["referee", str(file)])
    assert main() in (0, 1)
    assert capsys.readouterr().out.startswith("referee: ")
    with np.load(file) as read_back:
        arrays = {name: read_back[name] for name in read_back.files}
    for name in set(arrays) - {"digest", "format"}:
        content = bytearray(arrays[name].tobytes())
        if content:
            content[len(content) // 2] ^= 1
            other = np.frombuffer(bytes(content), arrays[name].dtype).reshape(arrays[name].shape)
            np.savez(file, **{**arrays, name: other})
            with pytest.raises(UnusableFile, match="has been changed"):
                load_proofs(file)
    file.write_bytes(pack_arrays({"cases": arrays["cases"]}))
    assert main() == 2
    assert "is no proof" in capsys.readouterr().err


def huge(file: Path) -> None:
    with file.open("wb") as out:
        np.lib.format.write_array_header_1_0(out, {"shape": (2**62,), "fortran_order": False, "descr": "|u1"})
    with zipfile.ZipFile(file.with_suffix(".npz"), "w") as archive:
        archive.write(file, "cases.npy")


def deep(file: Path) -> None:
    arrays = {"cases": np.frombuffer(b"[" * 100_000, np.uint8)}
    file.with_suffix(".npz").write_bytes(pack_arrays(arrays))


def cut(file: Path) -> None:
    file.with_suffix(".npz").write_bytes(pack_arrays({"cases": np.zeros(1000)})[:-100])


@pytest.mark.parametrize("spoil", [huge, deep, cut])
def test_a_file_made_to_hurt_is_refused(spoil, tmp_path, capsys, monkeypatch):
    spoil(tmp_path / "proof")
    monkeypatch.setattr("sys.argv", ["referee", str(tmp_path / "proof.npz")])
    assert main() == 2
    assert capsys.readouterr().err.startswith("proof.npz is no proof: ")


def test_a_proof_that_unpacks_to_too_much_isnt_unpacked(tmp_path: Path, monkeypatch: Any) -> None:
    (tmp_path / "proof.npz").write_bytes(pack_arrays({"cases": np.zeros(2**16)}))
    monkeypatch.setattr(proofs, "LARGEST", 2**16)
    with pytest.raises(UnusableFile, match="bytes unpacked, at most 65536 are read"):
        load_proofs(tmp_path / "proof.npz")


def test_a_proof_of_another_motion_is_refused(cases: list[tuple[Case, Proof]]) -> None:
    for case, proof in cases[:6]:
        later = case.times + 1e-3
        assert replay(dataclasses.replace(case, times=later), proof).answer is Answer.NOT_PROVED


def test_proofs_of_what_controllers_draw_hold(executed: list[tuple[Case, Proof]]) -> None:
    kinds = {(case.steps, case.velocities is None, case.accelerations is None) for case, _ in executed}
    tubes = sum(case.tolerance.any() for case, _ in executed)
    assert (len(kinds), tubes > 6) == (4, True)
    for case, proof in executed:
        assert replay(case, proof).answer is Answer.FREE


def follow_exactly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget that a robot may be beside the curve."""
    right = motion_bounds.pieces
    exactly = lambda case: (one._replace(beside=0.0 * one.beside) for one in right(case))  # noqa: E731
    monkeypatch.setattr(motion_bounds, "pieces", exactly)


def test_a_proof_tells_nothing_of_a_wider_tube_or_another_curve(executed: list[tuple[Case, Proof]]) -> None:
    refused = missed = others = 0
    for case, proof in executed:
        wider = dataclasses.replace(case, tolerance=case.tolerance + 0.5)
        if replay(wider, proof).answer is Answer.NOT_PROVED:
            refused += 1
            with pytest.MonkeyPatch.context() as patched:
                follow_exactly(patched)
                missed += replay(wider, proof).answer is Answer.FREE
        knots = case.positions.copy()
        knots[-1] += 1.5
        others += replay(dataclasses.replace(case, positions=knots), proof).answer is Answer.NOT_PROVED
    assert refused > 6
    assert missed > 3
    assert others > 3


def test_what_is_proved_is_free_wherever_the_robot_may_be(executed: list[tuple[Case, Proof]]) -> None:
    """Against Coal at places on the curve and beside it, drawn anew from the knots by SciPy."""
    rng = np.random.default_rng(0)
    for case, _ in executed:
        along, times = Along(dataclasses.replace(case, constraints=()), 0.0, 0.0, np.inf), case.times
        assert times is not None, "it has times"
        for time in rng.uniform(times[0], times[-1], 30):
            k = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
            share = (time - times[k]) / (times[k + 1] - times[k])
            if case.steps:
                share = rng.uniform(0.0, 1.0, len(case.tolerance))
            place = case.positions[k] + share * (case.positions[k + 1] - case.positions[k])
            if case.velocities is not None:
                told = [case.positions, case.velocities, *([] if case.accelerations is None else [case.accelerations])]
                place = BPoly.from_derivatives(times, np.stack(told, axis=1))(time)
            along._stand(place + rng.choice([-1.0, 0.0, 1.0], len(place)) * case.tolerance, float(time))
            for pair, _ in enumerate(along.pairs):
                broken, room, apart = along._pair(pair, 0.0)
                assert broken is None, (case.steps, time, apart, room)


def test_a_polygon_is_proved_as_it_is_divided() -> None:
    """Four corners in a convex row may be divided in two ways, of which a proof is about one."""
    drawn = draw(np.random.default_rng([62, False]), False)
    proof = proved(drawn.motion)
    assert proof is not None
    assert replay(read(drawn.motion, limits=False), proof).answer is Answer.FREE


TOOLS = Path(__file__).parents[2] / "tools"

SLICE = ["panda shelf tree as found", "panda shapes pose", "panda meshes", "panda cloud", "panda clearance"]
SLICE += ["panda held rod", "panda placed", "ur5 table", "lift prismatic continuous mimic", "followers turned"]
SLICE += ["wheeled planar", "balls", "floater", "moving door", "moving conveyor", "guided seed_b_tapered"]
SLICE += ["judged near", "judged among what moves", "judged samples"]


@pytest.fixture(scope="module")
def requests() -> Any:
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(str(TOOLS))
        from fixed.requests import REQUESTS
    return REQUESTS


@pytest.mark.parametrize("name", SLICE)
def test_the_proof_of_a_fixed_request_holds(name: str, requests: Any, tmp_path: Path) -> None:
    asked, engine, file = requests[name], Engine(), tmp_path / "proof.npz"
    if asked.get("type") == "certify":
        (motion,) = motions_of(msgspec.convert(asked, CertifyRequest))
    else:
        plan = msgspec.convert(asked, PlanRequest)
        plan = msgspec.structs.replace(plan, scene=engine._find_scene_message(plan.scene))
        motion = planned(plan, engine._load_robot(plan.robot))
    write_proof(file, motion)
    (verdict,) = replay_file(file)
    assert verdict.answer is Answer.FREE, verdict.finding
    assert verdict.kept > 0.0
    assert verdict.evaluations > 0


ARM = """<robot name="arm">
<link name="base"><collision><origin xyz="0 0 0.075"/><geometry><sphere radius="0.002"/></geometry></collision></link>
<link name="upper"><collision><origin xyz="0 0 0.075"/><geometry><sphere radius="0.04"/></geometry></collision></link>
<link name="side"><collision><origin xyz="0 0 0.1"/><geometry><sphere radius="0.02"/></geometry></collision></link>
<link name="lower"><collision><origin xyz="0 0 0.14"/>
<geometry><box size="0.1 0.02 0.08"/></geometry></collision></link>
<joint name="first" type="revolute"><origin xyz="0 0 0.15" rpy="0.1 -1.2 3.1"/>
<parent link="base"/><child link="upper"/>
<axis xyz="0 0 1"/><limit lower="-1.3" upper="1.1" effort="1" velocity="2"/></joint>
<joint name="fixed" type="fixed"><origin xyz="0 0 0.067"/><parent link="base"/><child link="side"/></joint>
<joint name="universe" type="revolute"><origin xyz="0 0 0.15" rpy="0 0.7 -0.2"/><parent link="upper"/>
<child link="lower"/><axis xyz="1 0 0"/><limit lower="-0.9" upper="2.6" effort="1" velocity="2"/></joint></robot>"""


MOVES = {
    "trajectory": {
        "positions": [[0.36 - 0.04 * k, 0.9 + 0.07 * k] for k in range(20)],
        "times": [0.1 * k for k in range(20)],
    }
}
RESTS = {"path": [[0.1, 0.9]] * 3}


@pytest.mark.parametrize("motion", [MOVES, RESTS], ids=["a joint called universe", "a path that goes nowhere"])
def test_proofs_of_odd_robots_and_motions_hold(motion: dict[str, Any], tmp_path: Path) -> None:
    asked = {
        "type": "certify",
        "robot": {"type": "urdf", "text": ARM},
        "scene": {"name": "none", "obstacles": []},
        **motion,
    }
    file = tmp_path / "proof.npz"
    reply = Engine().answer(msgspec.convert(asked, CertifyRequest), proof_to=file)
    assert reply.certificate.collision_free
    (verdict,) = replay_file(file)
    assert verdict.answer is Answer.FREE, verdict.finding
