"""What the laws of the kernel hand to each other: constants of a call, what a step did."""

from __future__ import annotations

from typing import NamedTuple


class Winding(NamedTuple):
    """Constants of the winding and the inverter."""

    pairs: float
    rail: float
    """Voltage of a leg without load (V)."""
    r_a: float
    r_b: float
    r_c: float
    g_a: float
    """Inverse inductance without saturation (1/H)."""
    g_b: float
    g_c: float
    k_a: float
    """`ports.phase_constant` (V s/rad)."""
    k_b: float
    k_c: float
    top: float
    """Width of the flat top (rad)."""
    harmonic: bool
    sines: bool
    """Whether sine and cosine of the electrical angle are needed."""
    swings: bool
    varies: bool
    """Whether inductances depend on currents."""
    ideal: bool


class Masses(NamedTuple):
    """Constants of the mechanics."""

    smooth: bool
    steady: bool
    dynamic_m: float
    """Dry friction of the motor where it is steady (N m)."""
    static_m: float
    dynamic_s: float
    static_s: float
    stiffness: float
    backlash: float
    inverse_ratio: float
    inverse_efficiency: float
    inverse_j_m: float
    inverse_j_s: float


class Sensors(NamedTuple):
    """Constants of the sensors."""

    instant: bool
    gain_a: float
    gain_b: float
    gain_c: float
    offset_a: float
    offset_b: float
    offset_c: float
    angle: float
    """Of the commutation sensor, beyond the electrical angle (rad)."""
    sine: float
    cosine: float
    position_offset: float
    position_step: float
    """Of the converter (rad); of the speed's (rad/s)."""
    speed_step: float
    delay: float
    """Of the reference current, in control periods, as it is recorded."""


class Circuit(NamedTuple):
    """The star of three phases with floating neutral, reduced to the currents a and b.

    di_a/dt = Σ_j a_j v_j - a_0 i_a - a_1 i_b - Σ_j a_j e_j, and with b alike; i_c = -i_a - i_b.
    """

    a_a: float
    """Weights of the voltages (1/H)."""
    a_b: float
    a_c: float
    b_a: float
    b_b: float
    b_c: float
    a_0: float
    """Weights of the currents (1/s)."""
    a_1: float
    b_0: float
    b_1: float


class Legs(NamedTuple):
    """What moves the legs of the inverter in a step."""

    s_a: float
    """States of the legs, ±1, or their means."""
    s_b: float
    s_c: float
    aim_a: float
    """Currents (A) that the relays aim at, and half widths of their bands (A)."""
    aim_b: float
    aim_c: float
    band_a: float
    band_b: float
    band_c: float
    change: float
    """When they aim at other currents (s), and at which (A)."""
    next_a: float
    next_b: float
    next_c: float
    begin: float
    """Begin and length of the carrier's period (s)."""
    period: float


class Flow(NamedTuple):
    """Currents at the end of a step, and what they did in it."""

    i_a: float
    i_b: float
    s_a: float
    s_b: float
    s_c: float
    charge_a: float
    """Integrals of the currents (A s)."""
    charge_b: float
    impulse: float
    """Integral of the torque (N m s)."""
    bus_charge: float
    """Taken from the bus (A s)."""
    terminal: float
    """Energy at the terminals (J)."""
    copper: float
    """Energy lost in the resistances (J)."""
    switches: int
    """Steps that it took."""


class Load(NamedTuple):
    """What gear and shaft do at an instant."""

    shaft: float
    """Torque of the shaft on the surface (N m)."""
    motor: float
    """Torque that the motor drives against (N m)."""
    surface: float
    """Torque on the surface against positive motion (N m)."""
    slope: float
    """Derivative of the gear's output to the motor angle."""


class Bodies(NamedTuple):
    """Speeds (rad/s) and accelerations (rad/s²) at the end of a step, surface angle (rad)."""

    w_m: float
    w_s: float
    al_m: float
    al_s: float
    q_s: float
    dry: float
    """Dynamic friction of the motor (N m)."""
