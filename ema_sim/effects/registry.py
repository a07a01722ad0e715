"""The registry of the effects: `Effects`, the parameters of all, and their descriptions."""

from __future__ import annotations

import sys
from typing import NamedTuple, get_type_hints

from ema_sim.effects.back_emf_shape import BackEmfShape
from ema_sim.effects.backlash import Backlash
from ema_sim.effects.base import Effect
from ema_sim.effects.bus_voltage_change import BusVoltageChange
from ema_sim.effects.bus_voltage_sag import BusVoltageSag
from ema_sim.effects.cogging_torque import CoggingTorque
from ema_sim.effects.control_delay import ControlDelay
from ema_sim.effects.current_sensor_gain import CurrentSensorGain
from ema_sim.effects.current_sensor_offset import CurrentSensorOffset
from ema_sim.effects.gear_mesh_ripple import GearMeshRipple
from ema_sim.effects.hall_misalignment import HallMisalignment
from ema_sim.effects.inertia_change import InertiaChange
from ema_sim.effects.inverter_voltage_drop import InverterVoltageDrop
from ema_sim.effects.load_dependent_friction import LoadDependentFriction
from ema_sim.effects.magnetic_saturation import MagneticSaturation
from ema_sim.effects.motor_friction import MotorFriction
from ema_sim.effects.phase_resistance_imbalance import PhaseResistanceImbalance
from ema_sim.effects.position_sensor_offset import PositionSensorOffset
from ema_sim.effects.quantisation import Quantisation
from ema_sim.effects.rotor_eccentricity import RotorEccentricity
from ema_sim.effects.shaft_compliance import ShaftCompliance
from ema_sim.effects.speed_sensor_runout import SpeedSensorRunout
from ema_sim.effects.stribeck_friction import StribeckFriction
from ema_sim.effects.surface_friction import SurfaceFriction
from ema_sim.effects.surface_load import SurfaceLoad
from ema_sim.effects.torque_constant_drop import TorqueConstantDrop
from ema_sim.effects.turn_short import TurnShort
from ema_sim.effects.viscous_friction import ViscousFriction
from ema_sim.effects.winding_temperature import WindingTemperature


class Effects(NamedTuple):
    """Parameters of all effects; the defaults are neutral."""

    turn_short: TurnShort = TurnShort()
    rotor_eccentricity: RotorEccentricity = RotorEccentricity()
    back_emf_shape: BackEmfShape = BackEmfShape()
    torque_constant_drop: TorqueConstantDrop = TorqueConstantDrop()
    winding_temperature: WindingTemperature = WindingTemperature()
    phase_resistance_imbalance: PhaseResistanceImbalance = PhaseResistanceImbalance()
    magnetic_saturation: MagneticSaturation = MagneticSaturation()
    hall_misalignment: HallMisalignment = HallMisalignment()
    control_delay: ControlDelay = ControlDelay()
    cogging_torque: CoggingTorque = CoggingTorque()
    motor_friction: MotorFriction = MotorFriction()
    surface_friction: SurfaceFriction = SurfaceFriction()
    viscous_friction: ViscousFriction = ViscousFriction()
    stribeck_friction: StribeckFriction = StribeckFriction()
    load_dependent_friction: LoadDependentFriction = LoadDependentFriction()
    backlash: Backlash = Backlash()
    shaft_compliance: ShaftCompliance = ShaftCompliance()
    gear_mesh_ripple: GearMeshRipple = GearMeshRipple()
    inverter_voltage_drop: InverterVoltageDrop = InverterVoltageDrop()
    bus_voltage_sag: BusVoltageSag = BusVoltageSag()
    bus_voltage_change: BusVoltageChange = BusVoltageChange()
    current_sensor_offset: CurrentSensorOffset = CurrentSensorOffset()
    current_sensor_gain: CurrentSensorGain = CurrentSensorGain()
    speed_sensor_runout: SpeedSensorRunout = SpeedSensorRunout()
    position_sensor_offset: PositionSensorOffset = PositionSensorOffset()
    quantisation: Quantisation = Quantisation()
    inertia_change: InertiaChange = InertiaChange()
    surface_load: SurfaceLoad = SurfaceLoad()


EFFECTS: dict[str, Effect] = {
    name: sys.modules[parameters.__module__].EFFECT
    for name, parameters in get_type_hints(Effects).items()
}
"""The registry: descriptions by name, in the order of `Effects`."""
