"""The functions of `ema_phm`: what the commands do, on objects and paths."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ema_record.errors import UsageError, unknown_name
from ema_record.record import Record
from ema_rig.record import RigRecord

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ema_identification.result import Identification
    from ema_prognostics.fleet.fleet import Fleet
    from ema_prognostics.trend.flights import Flight
    from ema_prognostics.trend.unit_trend import UnitTrend
    from ema_prognostics.verdict.judge import Judge
    from ema_prognostics.verdict.verdict import Verdict
    from ema_record.profile import Profile

Bag = str | PathLike[str]
Source = Record | Bag


def read(bag: Bag, *, profile: Bag | None = None) -> Record | RigRecord:
    """Return the record of a bag.

    Parameters
    ----------
    bag : rosbag2 directory or ``.mcap`` file, of the actuator's test or of a rig.
    profile : name or YAML file of the test that was commanded, in place of the bag's own.

    Raises
    ------
    RecordError
        It cannot be read.
    """
    from ema_rig.bag import read_any

    return read_any(Path(bag), None if profile is None else _text(profile))


def rig(
    values: Mapping[str, Any], *, motion: Literal["rotary", "linear"] = "rotary",
    name: str = "rig",
) -> RigRecord:
    """Return a record of any single axis from arrays, for `identify` and `write`.

    Parameters
    ----------
    values : arrays of shape (n,) by their channels, in SI units: ``time``; one of
        ``input_current``, ``input_voltage``, ``input_torque``, ``input_force``; ``position``,
        ``speed`` or both, and others that a rig has; a pandas frame will do.
    motion : whether it turns (rad) or slides (m).
    name : of the axis.

    Raises
    ------
    UsageError, InvalidRecordError
        A channel that does not exist or lacks, or values that cannot be used.
    """
    from ema_rig.record import rig_record

    return rig_record(values, motion, name)


def write(record: Record | RigRecord, bag: Bag) -> Path:
    """Write a record as a new bag, the same bytes for the same record, and return its path."""
    if isinstance(record, RigRecord):
        from ema_rig.bag import write_rig_bag

        return write_rig_bag(record, Path(bag))
    from ema_record.bag.read import write_bag

    return write_bag(_record(record), Path(bag))


def simulate(
    profile: Profile | Bag = "extended", *, effects: Mapping[str, Any] | Iterable[str] = (),
    model: Bag | None = None, seed: int = 0, noise: float = 1.0,
    serial_number: str = "SIM-0000", start_time: int = 0,
) -> Record:
    """Run a test on the emulated actuator and return its record.

    Parameters
    ----------
    profile : a test: its name in the kit, a YAML file, or a `Profile`.
    effects : what is hidden in the actuator: ``{"turn_short.fraction": 0.1}`` or
        ``["turn_short.fraction=0.1"]``; `effects` of this module lists them.
    model : YAML file of changed parameters and effects.
    seed : of noise and start angle; the same seed gives the same bytes.
    noise : factor on the sensor noise, 0 for none.
    serial_number, start_time : for the record; ns since the epoch.

    Raises
    ------
    UsageError, SimulationError
    """
    from ema_record.profile import Profile, load_profile
    from ema_sim.effects.settings import effects_from_mapping, parse_effects
    from ema_sim.model_file import load_model_file
    from ema_sim.simulate import simulate as run

    given = load_model_file(None if model is None else Path(model))
    if isinstance(effects, str):
        effects = [effects]
    chosen = (effects_from_mapping(effects, given.effects) if isinstance(effects, Mapping)
              else parse_effects(effects, given.effects))
    test = profile if isinstance(profile, Profile) else load_profile(_text(profile))
    return run(test, actuator=given.actuator, effects=chosen, seed=seed, noise=noise,
               serial_number=serial_number, start_time=start_time)


def diagnose(
    source: Source, *, baseline: Source | None = None, model: Bag | None = None,
    profile: Bag | None = None, mode: str = "robust",
) -> Verdict:
    """Return what ``ema check`` says of a bag or record.

    Parameters
    ----------
    source : bag or record. One that cannot be read is incomplete or invalid.
    baseline : healthy bag or record of the same actuator and test.
    model : file of trained networks, default the kit's.
    profile : the test that was commanded.
    mode : ``robust`` or ``paper``.

    Raises
    ------
    UsageError, ModelError
    """
    judge = _judge(model, baseline, profile, mode)
    if isinstance(source, Record):
        return judge.of_record(source, source.provenance.source).verdict
    return judge.of_bag(_text(source)).verdict


def identify(
    measured: Source | RigRecord | Sequence[Source | RigRecord], *, model: Bag | None = None,
    validate: Source | RigRecord | Sequence[Source | RigRecord] = (),
    baseline: Source | Sequence[Source] = (),
    without: Sequence[str] = (), workers: int = 1, seed: int = 0,
) -> Identification:
    """Return what a model lacks to explain records: ``ema identify``.

    Parameters
    ----------
    measured : bags or records of one unit.
    model : YAML file, default the kit's actuator.
    validate : of the same unit, that take no part in the fit.
    baseline : of its acceptance, same test; `Identification.since` says what has changed.
    without : effects that are not considered.
    workers : simulations at a time.
    seed : of the simulations.

    Raises
    ------
    RecordError, UsageError
    """
    from ema_identification.identify import identify as run

    return run([_read(one) for one in _several(measured)],
               None if model is None else Path(model),
               validate=[_read(one) for one in _several(validate)],
               baseline=[_read(one) for one in _several(baseline)], without=without,
               workers=workers, seed=seed)


def trend(
    flights: Source | Sequence[Source], *, rule: str = "2/3", model: Bag | None = None,
    baseline: Source | None = None, profile: Bag | None = None,
) -> UnitTrend:
    """Return how the faults of one actuator grow from flight to flight: ``ema trend``.

    Parameters
    ----------
    flights : a folder of bags, or bags and records, in any order.
    rule : ``K/N``: confirmed when K of the last N flights find it.
    model, baseline, profile : as of `diagnose`.

    Raises
    ------
    UsageError
        Flights of several actuators: use `fleet`.
    """
    from ema_prognostics.trend.announcement import parse_rule
    from ema_prognostics.trend.flights import by_unit
    from ema_prognostics.trend.unit_trend import trend_of
    from ema_record.bag.find import bags_of, is_sequence

    chosen, judge = parse_rule(rule), _judge(model, baseline, profile)
    sources: list[Source] = []
    for one in _several(flights):
        folder = not isinstance(one, Record) and is_sequence(Path(one))
        sources += bags_of(Path(_text(one)))[0] if folder else [one]
    if not sources:
        raise UsageError("0 flights: give bags, records, or a folder of bags")
    units = by_unit(_flight(judge, one, k) for k, one in enumerate(sources, start=1))
    if len(units) > 1:
        raise UsageError(f"flights of {len(units)} actuators ({', '.join(units)[:80]}): give "
                         "those of one, or use fleet()")
    return trend_of(*next(iter(units.items())), chosen)


def fleet(
    paths: Bag | Sequence[Bag], *, rule: str = "2/3", model: Bag | None = None,
    profile: Bag | None = None, jobs: int | None = None, dask: str | None = None,
) -> Fleet:
    """Return the units of all bags below folders, worst first: ``ema fleet``.

    Parameters
    ----------
    paths : folders, searched to their depth, or bags. A bag is judged once.
    rule, model, profile : as of `trend`.
    jobs : worker processes, default one a core.
    dask : address of a dask scheduler that you trust: it runs code in this process.

    Raises
    ------
    UsageError, RecordError
    """
    from ema_prognostics.fleet.fleet import read_fleet
    from ema_prognostics.trend.announcement import parse_rule

    return read_fleet(
        [_text(one) for one in _several(paths)], rule=parse_rule(rule), jobs=jobs, dask=dask,
        model=None if model is None else _text(model),
        profile=None if profile is None else _text(profile))


def plot(shown: Source | UnitTrend, name: str = "speed") -> Figure:
    """Return a matplotlib Figure.

    Parameters
    ----------
    shown : a bag or record, or the trend of a unit.
    name : of a record's plot: speed, currents, spectrum, surface or torque.

    Raises
    ------
    UsageError
        A plot that does not exist, or of which the record does not hold enough.
    """
    from ema_prognostics.trend.unit_trend import UnitTrend

    if isinstance(shown, UnitTrend):
        from ema_cli.views.flights_plot import trend_figure

        return _shown(trend_figure(shown))
    from ema_cli.views.record_plots import NAMES, record_figures

    if name not in NAMES:
        raise unknown_name("plot", name, NAMES, f"a record has {', '.join(NAMES)}")
    found = record_figures(_record(_read(shown)))
    if name not in found:
        raise UsageError(f"plot {name!r}: the record has no whole turns at constant speed; it has "
                         f"{', '.join(found)}")
    return _shown(found[name])


def _shown(figure: Figure) -> Figure:
    """Return the figure as one that a notebook shows, whatever backend it has."""
    figure._repr_png_ = partial(_png, figure)  # type: ignore[attr-defined]
    return figure


def _png(figure: Figure) -> bytes:
    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def effects() -> dict[str, str]:
    """Return the effects of the catalogue with what each is."""
    from ema_sim.effects import EFFECTS

    return {name: effect.summary for name, effect in EFFECTS.items()}


def profiles() -> list[str]:
    """Return the names of the kit's tests."""
    from ema_record.profile import profile_names

    return profile_names()


def to_json(source: Source, *, model: Bag | None = None, profile: Bag | None = None
            ) -> dict[str, Any]:
    """Return the object that ``ema check --json`` prints; that of a record has no SHA-256."""
    from ema_prognostics.verdict.contract import trace_of, verdict_object

    judge = _judge(model, None, profile)
    if isinstance(source, Record):
        judged = judge.of_record(source, source.provenance.source or "record")
        return verdict_object(judged, trace_of(judge.model_sha256), record_sha256="")
    return verdict_object(judge.of_bag(_text(source)), trace_of(judge.model_sha256))


def _judge(
    model: Bag | None, baseline: Source | None, profile: Bag | None, mode: str = "robust"
) -> Judge:
    from ema_prognostics.verdict.diagnose import MODES
    from ema_prognostics.verdict.judge import Judge

    chosen = next((known for known in MODES if known == mode), None)
    if chosen is None:
        raise unknown_name("mode", mode, MODES, f"give one of {', '.join(MODES)}")
    own = baseline if baseline is None or isinstance(baseline, Record) else _text(baseline)
    return Judge(None if model is None else _text(model), own, mode=chosen,
                 profile=None if profile is None else _text(profile))


def _flight(judge: Judge, source: Source, number: int) -> Flight:
    from ema_prognostics.trend.flights import Flight

    if isinstance(source, Record):
        judged = judge.of_record(source, source.provenance.source or f"record {number}")
    else:
        judged = judge.of_bag(_text(source))
    return Flight(**judged._asdict())


def _several(given: Any) -> list[Any]:
    """Return one or several as a list."""
    return [given] if isinstance(given, str | PathLike | Record | RigRecord) else list(given)


def _read(given: Source | RigRecord) -> Record | RigRecord:
    return given if isinstance(given, Record | RigRecord) else read(given)


def _record(given: object) -> Record:
    if not isinstance(given, Record):
        raise UsageError(f"{type(given).__name__}: expected a record of the actuator's test: "
                         "read() or simulate() give one")
    return given


def _text(path: Bag) -> str:
    if not isinstance(path, str | PathLike):
        raise UsageError(f"{type(path).__name__} {str(path)[:40]!r}: expected a path, a name or a "
                         "record")
    return str(path)
