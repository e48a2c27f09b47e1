"""Jacobians and dynamics: against Pinocchio, finite differences and closed forms."""

import numpy as np
import pinocchio as pin
import pytest

import guidefield
from guidefield.errors import MalformedRequest, RobotInvalid, UnknownFrame
from guidefield.handlers.configurations import configurations_from, whole_group
from guidefield.messages.values import Placement
from tests.robots import box_arm, load, robot

JOINTS = [f"panda_joint{i}" for i in range(1, 8)]
BASE = Placement((1.0, -2.0, 0.5), (0.0, 0.0, float(np.sin(0.4)), float(np.cos(0.4))))
PENDULUM = """<robot name="pendulum"><link name="base"/><link name="bob">
<inertial><origin xyz="0 0 -0.5"/><mass value="2"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>
</inertial><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="bob"/><axis xyz="0 1 0"/></joint>
{more}</robot>"""
GEARED = """<link name="gear"><inertial><mass value="1"/>
<inertia ixx="0.2" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial></link>
<joint name="geared" type="continuous"><parent link="base"/><child link="gear"/><axis xyz="0 1 0"/>
<mimic joint="hinge" multiplier="3"/></joint>"""


def pendulum(more: str = "") -> dict[str, str]:
    return {"type": "urdf", "text": PENDULUM.format(more=more)}


class TestJacobian:
    @pytest.mark.parametrize("frame", ["local", "world", "local_world_aligned"])
    def test_it_is_pinocchios_for_a_robot_placed_elsewhere(self, frame: str):
        model, rng = robot("panda"), np.random.default_rng(1)
        rows, rates = rng.uniform(-1.0, 1.0, (3, 7)), rng.uniform(-1.0, 1.0, (3, 7))
        reply = guidefield.answer(
            {
                "type": "jacobian",
                "robot": "panda",
                "frames": ["panda_hand", "panda_link3"],
                "configurations": {"names": JOINTS, "rows": rows},
                "velocities": {"names": JOINTS, "rows": rates},
                "reference_frame": frame,
                "robot_placement": BASE,
            }
        )
        placed = whole_group(model, BASE).model  # its root joint stands at the placement
        data, reference = placed.createData(), getattr(pin, frame.upper())
        found, columns = np.array(reply.jacobian), [reply.velocity_names.index(name) for name in JOINTS]
        for n, q in enumerate(configurations_from(model, [dict(zip(JOINTS, row, strict=True)) for row in rows])):
            for k, name in enumerate(("panda_hand", "panda_link3")):
                wanted = pin.computeFrameJacobian(placed, data, q, placed.getFrameId(name), reference)
                assert found[n, k][:, columns] == pytest.approx(wanted[:, :7], abs=1e-12)
            assert reply.twist[n][0] == pytest.approx(found[n, 0][:, columns] @ rates[n], abs=1e-12)

    def test_a_mimic_joint_adds_to_the_column_of_its_source(self):
        request = {"type": "jacobian", "robot": pendulum(GEARED), "frames": ["gear", "bob"], "configurations": [{}]}
        reply = guidefield.answer(request)
        assert reply.velocity_names == ["hinge"]
        assert reply.jacobian[0][0] == [[0.0], [0.0], [0.0], [0.0], [3.0], [0.0]]
        assert reply.jacobian[0][1] == [[0.0], [0.0], [0.0], [0.0], [1.0], [0.0]]

    def test_columns_of_a_floating_joint_are_tangents(self):
        arm = box_arm("y floating", 2)
        configuration = {"j1": 0.3, "j2": [0.1, 0.2, 0.3, 0.0, 0.6, 0.0, 0.8]}
        request = {
            "type": "jacobian",
            "robot": arm,
            "frames": ["l2"],
            "configurations": [configuration],
            "packed": True,
        }
        reply = guidefield.answer(request)
        found = np.frombuffer(reply.packed.float64).reshape(reply.packed.shape)[0, 0]
        model = load(arm).model
        q = configurations_from(load(arm), [configuration])[0]
        data, h, frame = model.createData(), 1e-6, model.getFrameId("l2")
        pin.framesForwardKinematics(model, data, q)
        here = data.oMf[frame].copy()
        for column in range(model.nv):
            pin.framesForwardKinematics(model, data, pin.integrate(model, q, h * np.eye(model.nv)[column]))
            moved = data.oMf[frame]
            assert found[:3, column] == pytest.approx((moved.translation - here.translation) / h, abs=1e-5)
            turn = pin.log3(moved.rotation @ here.rotation.T) / h
            assert found[3:, column] == pytest.approx(turn, abs=1e-5)


class TestDynamics:
    QUANTITIES = ("inverse_dynamics", "gravity", "mass_matrix", "centre_of_mass")

    def test_they_are_pinocchios(self):
        model, rng = robot("panda"), np.random.default_rng(2)
        rows, rates, changes = (rng.uniform(-1.0, 1.0, (2, 7)) for _ in range(3))
        asked = {
            "type": "dynamics",
            "robot": "panda",
            "configurations": {"names": JOINTS, "rows": rows},
            "velocities": {"names": JOINTS, "rows": rates},
            "accelerations": {"names": JOINTS, "rows": changes},
            "quantities": self.QUANTITIES,
            "robot_placement": BASE,
        }
        reply, packed = guidefield.answer(asked), guidefield.answer({**asked, "packed": True}).packed
        placed = whole_group(model, BASE).model
        data, at = placed.createData(), [reply.velocity_names.index(name) for name in JOINTS]
        for n, q in enumerate(configurations_from(model, [dict(zip(JOINTS, row, strict=True)) for row in rows])):
            v, a = np.zeros(placed.nv), np.zeros(placed.nv)
            v[:7], a[:7] = rates[n], changes[n]
            expand = whole_group(model, BASE).expand_velocity
            torques = expand.T @ pin.rnea(placed, data, q, v, a)
            assert reply.inverse_dynamics[n] == pytest.approx(torques, abs=1e-9)
            assert reply.gravity[n] == pytest.approx(expand.T @ pin.rnea(placed, data, q, 0 * v, 0 * a), abs=1e-9)
            assert reply.centre_of_mass[n] == pytest.approx(pin.centerOfMass(placed, data, q), abs=1e-12)
            mass = np.array(reply.mass_matrix[n])
            assert mass == pytest.approx(mass.T)
            assert np.linalg.eigvalsh(mass).min() > 0.0
            still = expand.T @ pin.rnea(placed, data, q, v, 0 * a)
            assert mass[:, at] @ changes[n] == pytest.approx(torques - still, abs=1e-9)
        assert reply.mass == pytest.approx(pin.computeTotalMass(placed))
        for name in self.QUANTITIES:
            assert np.frombuffer(packed[name].float64).reshape(packed[name].shape).tolist() == getattr(reply, name)

    def test_a_pendulum_with_a_payload_in_closed_form(self):
        angle, payload = 0.7, {"link": "bob", "mass": 1.0, "centre_of_mass": [0.0, 0.0, -1.0]}
        request = {
            "type": "dynamics",
            "robot": pendulum(),
            "configurations": [{"hinge": angle}],
            "quantities": ["gravity", "mass_matrix"],
            "payload": [payload],
            "gravity": [0.0, 0.0, -10.0],
        }
        reply = guidefield.answer(request)
        assert reply.gravity[0] == pytest.approx([(2.0 * 0.5 + 1.0) * 10.0 * np.sin(angle)], rel=1e-12)
        assert reply.mass_matrix[0] == [[pytest.approx(0.1 + 2.0 * 0.25 + 1.0, rel=1e-12)]]
        assert reply.mass == 3.0
        assert reply.inverse_dynamics is None

    def test_a_mimic_joint_burdens_its_source(self):
        request = {"type": "dynamics", "robot": pendulum(GEARED), "configurations": [{}], "quantities": ["mass_matrix"]}
        assert guidefield.answer(request).mass_matrix == [[[pytest.approx(0.1 + 2.0 * 0.25 + 9 * 0.2)]]]

    def test_a_robot_without_inertia_is_told_so(self):
        request = {"type": "dynamics", "robot": box_arm("y", 2), "configurations": [{}], "quantities": ["gravity"]}
        with pytest.raises(RobotInvalid, match="has no inertia"):
            guidefield.answer(request)
        held = guidefield.answer({**request, "payload": [{"link": "l1", "mass": 1.0}]})
        assert held.warnings == ["no link that j2 move has a mass: their rows of the dynamics are 0"]

    def test_faults(self):
        request = {"type": "dynamics", "robot": pendulum(), "configurations": [{}, {}], "quantities": ["gravity"]}
        with pytest.raises(UnknownFrame, match=r"`payload\[0\]`: the robot has no link 'nose'"):
            guidefield.answer({**request, "payload": [{"link": "nose", "mass": 1.0}]})
        with pytest.raises(MalformedRequest, match="principal moments 1, 1, 3"):
            guidefield.answer({**request, "payload": [{"link": "bob", "mass": 1.0, "inertia": [1, 0, 0, 1, 0, 3]}]})
        with pytest.raises(MalformedRequest, match="one for each of the 2 configurations, not 1"):
            guidefield.answer({**request, "velocities": [{"hinge": 1.0}]})
        with pytest.raises(MalformedRequest, match="`accelerations` are for `inverse_dynamics`"):
            guidefield.answer({**request, "accelerations": [{}, {}]})
