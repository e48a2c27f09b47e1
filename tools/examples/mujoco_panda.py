"""A Panda in MuJoCo executes a plan at 1 kHz by position servos; what it executed is judged against the plan.

    pip install 'guidefield[mujoco]'
    python mujoco_panda.py [RECORDING.rrd]

The plan is certified for steps of commands, within a tolerance that such servos keep: they are behind by their damping.
"""

import re
import sys
from pathlib import Path

import mujoco
import numpy as np

import guidefield
from guidefield.robot.catalog import Catalog

STIFFNESS, DAMPING, ROTOR = 2e4, 200.0, 0.1  # of each servo [N m/rad, N m s/rad], and of its rotor [kg m²]
RATE, TOLERANCE = 1000, 0.02  # of the servos [Hz]; behind by DAMPING / STIFFNESS of a speed: 0.02 rad, and accelerating
START = {"panda_joint1": 0.0, "panda_joint2": -0.7, "panda_joint4": -2.3, "panda_joint6": 1.6, "panda_joint7": 0.8}
GOAL = {"panda_joint1": 1.2, "panda_joint2": -0.2, "panda_joint4": -1.6}
REQUEST = guidefield.PlanRequest(
    "panda",
    "table",
    guidefield.JointsGoal(GOAL),
    start=START,
    guide_planes=[],
    min_clearance=0.01,
    execution=guidefield.ExecutionOptions("zero_order_hold", rate=RATE, tolerance=TOLERANCE),
)


def simulate(joints: list[str], commands: np.ndarray) -> np.ndarray:
    """Have the robot follow commands (n, k), one a tick, from the first on; where it is after each tick (n, k)."""
    urdf = Path(str(Catalog().load("panda").source.urdf_path)).read_text()
    spec = mujoco.MjSpec.from_string(re.sub(r"<(visual|collision)>.*?</\1>", "", urdf, flags=re.DOTALL))
    spec.option.timestep, spec.option.integrator = 1.0 / RATE, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for body in spec.bodies:
        body.gravcomp = 1.0  # as robots' own controllers do
    for joint in joints:
        spec.joint(joint).armature = ROTOR
        servo = spec.add_actuator(target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=STIFFNESS, kv=DAMPING)
    model = spec.compile()
    data, at = mujoco.MjData(model), [model.joint(joint).qposadr[0] for joint in joints]
    data.qpos[at] = commands[0]
    places = []
    for command in commands:
        data.ctrl[:] = command
        mujoco.mj_step(model, data)
        places.append(data.qpos[at].copy())
    return np.array(places)


def main(recording: str | None) -> None:
    """Plan, execute and judge."""
    plan = guidefield.answer(REQUEST)
    print(plan.status.message)
    commands = np.array(plan.execution.positions)
    commands = np.concatenate([commands, np.repeat(commands[-1:], 100, axis=0)])  # until it stands
    places = simulate(plan.position_names, commands)
    before = np.concatenate([commands[:1], commands[:-1]])
    low, high = np.minimum(before, commands), np.maximum(before, commands)
    beyond = np.maximum(low - places, places - high).max()
    print(f"{beyond:.4f} rad beyond the steps at most, {TOLERANCE} allowed")
    times = (np.arange(len(places)) + 1) / RATE
    states = guidefield.JointStates(plan.position_names, times.tolist(), places.tolist())
    judged = guidefield.answer(guidefield.judgement_of(REQUEST, plan, states), record_to=recording)
    off, kept = judged.deviation, judged.clearance.minimum
    print(
        f"executed: {judged.certificate.reason}, {off.largest:.4f} rad off the plan by {off.joint}, {kept:.4f} m kept"
    )


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
