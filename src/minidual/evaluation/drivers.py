"""Factories of the compared methods; heavy parts load when a method is used."""

from __future__ import annotations

from minidual.evaluation.methods import Factory, MethodInputs


def impedance(inputs: MethodInputs) -> Factory:
    """Object impedance."""
    from minidual.tasks.impedance_carry import ImpedanceCarry

    config = inputs.config.carry
    return lambda world, kinematics, trial: ImpedanceCarry(world, kinematics, config, trial)


def planned(inputs: MethodInputs) -> Factory:
    """Plan with OMPL and toppra, execute with joint trajectory control."""
    from minidual.tasks.planned_carry import PlannedCarry

    config, seed = inputs.config.plan, inputs.seed
    return lambda world, kinematics, trial: PlannedCarry(world, kinematics, config, trial, seed)


def policy(inputs: MethodInputs) -> Factory:
    """Run a trained policy from camera and joints through the command arbiter."""
    from minidual.errors import UsageError
    from minidual.learning.pilot import PolicyPilot, load_runtime

    if inputs.checkpoint is None:
        raise UsageError("method 'act' needs a checkpoint", remedy="minidual train-act")
    runtime = load_runtime(inputs.checkpoint)
    return lambda world, kinematics, trial: PolicyPilot(world, kinematics, runtime)
