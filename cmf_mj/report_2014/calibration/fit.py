"""The fit: least squares on the linear loop, shifted to what the simulation gives.

With f(x) the linear results at parameters x, s(x) the simulated ones and p the printed ones, a
residual is

    bandwidth   ln((f(x) + d) / p) / tolerance        damping   (f(x) + d - p) / tolerance

where d = s(x0) - f(x0) is what linearisation misses at the point x0 of the last simulation (output
space mapping: one simulation a round instead of one a derivative). The rounds end at parameters
where d is measured, so the residuals reported are those of the simulation. Where the velocity law
must stay stable with several cabs, each adds max(0, m - z) / 0.01 with z the least damping ratio of
its linear loop and m the one asked for. Solved by scipy.optimize.least_squares within the bounds.

The ranges are propagated by a Latin hypercube over all parameters at once, uniform and independent
between `low` and `high`.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import optimize

from cmf_mj.analysis.measures import Measures
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Field, Result, Table, fields_of, number
from cmf_mj.report_2014.calibration import trial
from cmf_mj.report_2014.calibration.trial import MEASURES
from cmf_mj.show.look import BLUE, GREY, ORANGE, new_figure, save_files

Results = Mapping[str, Measures]
Shift = Mapping[str, Mapping[trial.Measure, float]]

_SOFT = 0.01
"""Shortfall of the least damping ratio that weighs as much as one tolerance."""


MEASURE_TITLES = {"phase": "-90 deg", "gain": "-3 dB", "damping": "zeta"}
"""What a reader calls each measure."""


class Residual(NamedTuple):
    """One printed number and the computed one."""

    table: str
    law: str
    of: str  #: `hardware` or `nonlinear`, what was printed of.
    measure: trial.Measure
    role: str  #: `fitted` or `predicted`.
    printed: float  #: Hz, or 1 for a damping ratio.
    computed: float  #: NaN where the step rings on.
    deviation: float  #: Relative for a bandwidth, absolute for a damping ratio.
    tolerance: float
    within: bool  #: False where the step rings on.
    stable: bool  #: The verdict on the step.


class CalibrationStage(NamedTuple):
    """Parameters with their linear and simulated results."""

    values: dict[str, float]
    linear: dict[str, Measures]
    simulated: dict[str, Measures]
    least_damping: dict[str, float]  #: Of the velocity law's linear loop, by cab.


ENDS = (0.05, 0.95)
"""Quantiles that bound a spread."""


class Spread(NamedTuple):
    """Distribution of one result over the ranges of the parameters."""

    law: str
    measure: Annotated[trial.Measure, Field(title="what", form=MEASURE_TITLES.get)]
    nominal: Annotated[float, Field(form=".2f")]  #: At the nominal values [Hz or 1].
    low: Annotated[float, Field(title="5 %", form=".2f")]
    """5 % of the stable samples lie below."""
    high: Annotated[float, Field(title="95 %", form=".2f")]
    """95 % of the stable samples lie below."""
    unstable: Annotated[float, Field(form=".0f %", unit="%")]
    """Share of samples whose loop is unstable."""


class Calibration(NamedTuple):
    """A finished study."""

    study: trial.CalibrationStudy
    stages: tuple[CalibrationStage, ...]  #: As shipped, then after each round.
    standard_errors: dict[str, float]
    """Of the free parameters in their units, from s^2 (J' J)^-1, s^2 the mean squared residual."""
    spread: Result[Spread] | None = None
    """Of results over the ranges of the parameters, about the shipped values."""
    verdicts: Sequence[trial.StepVerdict] = ()  #: Step runs with the fitted values.

    @property
    def before(self) -> CalibrationStage:
        """As shipped."""
        return self.stages[0]

    @property
    def after(self) -> CalibrationStage:
        """As fitted."""
        return self.stages[-1]


def residual_rows(study: trial.CalibrationStudy, results: Results) -> list[Residual]:
    """Every printed number of a study with the computed one."""
    rows = []
    for row, measure in product(study.rows, trial.MEASURES):
        if measure not in (*row.fitted, *row.predicted):
            continue
        measures, printed = results[row.law], row.printed(measure)
        value = trial.computed(measures, measure) if measures.stable else float("nan")
        off = value - printed if measure == "damping" else value / printed - 1.0
        tolerance = study.tolerance[measure]
        role = "fitted" if measure in row.fitted else "predicted"
        numbers = (printed, value, off, tolerance, abs(off) <= tolerance, measures.stable)
        rows.append(Residual(row.table, row.law, row.of, measure, role, *numbers))
    return rows


def _cost_vector(
    study: trial.CalibrationStudy, values: trial.Values, shift: Shift
) -> NDArray[np.float64]:
    fitted = {row.law: None for row in study.rows if row.fitted}
    stepped = any("damping" in row.fitted for row in study.rows)
    linear = trial.linear_results(study, values, tuple(fitted), damping=stepped)
    cost = []
    for row in study.rows:
        for measure in row.fitted:
            value = trial.computed(linear[row.law], measure) + shift[row.law][measure]
            printed = row.printed(measure)
            off = value - printed if measure == "damping" else np.log(value / printed)
            cost.append(off / study.tolerance[measure])
    for damping in trial.least_damping(study, values).values():
        cost.append(max(0.0, study.least_damping - damping) / _SOFT)
    return np.asarray(cost, dtype=float)


def calibrate(
    study: trial.CalibrationStudy,
    *,
    rounds: int = 1,
    quick: bool = False,
    jobs: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Calibration:
    """Fit the free parameters of a study.

    `rounds` are fits, each followed by a simulation, with sweeps of 30 s instead of 100 s where
    `quick`, on `jobs` threads. `progress` is called with a line of text at each step.
    """
    if rounds < 1:
        raise InputError(f"rounds: {rounds} must be at least 1")
    report = progress or (lambda text: None)

    def stage(values: dict[str, float]) -> CalibrationStage:
        return CalibrationStage(
            values,
            trial.linear_results(study, values, study.laws),
            trial.simulated_results(study, values, study.laws, quick=quick, jobs=jobs),
            trial.least_damping(study, values),
        )

    report(f"{study.name}: as shipped")
    stages = [stage(trial.starting_values(study))]
    free = study.free
    low, high = (np.array([getattr(p, end) for p in free]) for end in ("low", "high"))
    names, scale = [p.name for p in free], high - low
    for once in range(1, rounds + 1):
        report(f"{study.name}: round {once} of {rounds}")
        last = stages[-1]
        # What linearisation misses at the parameters of the last stage, by law and measure.
        shift = {
            law: {
                m: trial.computed(simulated, m) - trial.computed(last.linear[law], m)
                for m in trial.MEASURES
            }
            for law, simulated in last.simulated.items()
        }

        def cost(
            share: NDArray[np.float64], last: CalibrationStage = last, shift: Shift = shift
        ) -> NDArray[np.float64]:
            chosen = dict(zip(names, low + share * scale, strict=True))
            return _cost_vector(study, last.values | chosen, shift)

        start = (np.array([last.values[name] for name in names]) - low) / scale
        solved = optimize.least_squares(
            cost, np.clip(start, 0.01, 0.99), bounds=(0.0, 1.0), diff_step=5e-3, xtol=1e-4
        )
        fitted = (low + solved.x * scale).tolist()
        stages.append(stage(last.values | dict(zip(names, fitted, strict=True))))
    square = float(solved.fun @ solved.fun) / max(1, solved.fun.size - scale.size)
    errors = np.sqrt(np.diag(np.linalg.pinv(solved.jac.T @ solved.jac) * square)) * scale
    return Calibration(study, tuple(stages), dict(zip(names, errors.tolist(), strict=True)))


def examine(
    calibration: Calibration, *, samples: int = 128, jobs: int | None = None
) -> Calibration:
    """Add uncertainty and the stability runs of a study that asks for them."""
    study, shipped = calibration.study, calibration.before.values
    return calibration._replace(
        spread=uncertainty(study, shipped, ("original", "velocity"), samples=samples),
        verdicts=trial.simulated_stability(study, calibration.after.values, jobs=jobs),
    )


def uncertainty(
    study: trial.CalibrationStudy,
    values: trial.Values,
    laws: tuple[str, ...] = ("velocity",),
    *,
    samples: int = 128,
    seed: int = 0,
) -> Result[Spread]:
    """Propagate the ranges of all parameters to the results of laws.

    `samples` of the Latin hypercube are at least 2, `seed` is its seed.
    """
    if samples < 2:
        raise InputError(f"samples: {samples} must be at least 2")
    drawn = study.unknowns.draw("latin_hypercube", samples, seed)
    runs = [trial.linear_results(study, values, laws) for values in drawn]
    nominal = trial.linear_results(study, values, laws)
    spreads = []
    for law, measure in product(laws, trial.MEASURES):
        known = [trial.computed(run[law], measure) for run in runs if run[law].stable]
        low_end, high_end = np.nanquantile(known or [np.nan], ENDS)
        unstable = 1.0 - float(np.mean([run[law].stable for run in runs]))
        value = trial.computed(nominal[law], measure)
        spreads.append(Spread(law, measure, value, float(low_end), float(high_end), unstable))
    return Result(spreads, fields_of(Spread), "uncertainty from the ranges")


def _off(row: Residual) -> str:
    scale, form = (1.0, "+.2f") if row.measure == "damping" else (100.0, "+.1f %")
    text = number(scale * row.deviation, form)
    return f"{text} !" if not row.within and (text != "-" or not row.stable) else text


def _pairs(calibration: Calibration) -> list[tuple[Residual, Residual]]:
    """Residuals as shipped and as fitted."""
    stages = (calibration.before.simulated, calibration.after.simulated)
    return list(zip(*(residual_rows(calibration.study, one) for one in stages), strict=True))


def calibration_tables(calibration: Calibration) -> list[Table]:
    """Parameters, residuals, uncertainty and, where there is one, least damping."""
    study, before, after = calibration.study, calibration.before, calibration.after
    parameters, residuals = [], []
    for p in study.parameters:
        error = calibration.standard_errors.get(p.name)
        fitted = "held" if error is None else f"{after.values[p.name]:.4g} +- {error:.2g}"
        bounds = f"{p.low:g} to {p.high:g}"
        parameters.append((p.name, p.unit, before.values[p.name], fitted, bounds, p.source))
    for pair in _pairs(calibration):
        a = pair[0]
        name = (a.table, a.law, "h" if a.of == "hardware" else "m", MEASURE_TITLES[a.measure])
        ours = [(row.computed if row.stable else "unstable", _off(row)) for row in pair]
        residuals.append((*name, a.role, a.printed, *ours[0], *ours[1]))
    about = ("parameter", "unit", ("shipped", ".4g"), "fitted", "range", "source of the range")
    header = ("table", "law", "of", "what", "role", ("printed", ".2f"), ("shipped", ".2f"))
    tables = [
        Table(f"{study.name}: {study.title}", about, parameters),
        Table(
            "residuals of the simulation",
            (*header, ("off", ""), ("fitted", ".2f"), ("off", "")),
            residuals,
        ),
    ]
    tables += [calibration.spread.table] if calibration.spread else []
    if before.least_damping:
        damping = [
            (cab, ratio, after.least_damping[cab]) for cab, ratio in before.least_damping.items()
        ]
        columns = ("cab", ("least damping, shipped", ".3f"), ("fitted", ".3f"))
        tables.append(Table("velocity law, linear", columns, damping))
    return tables


def verdict_text(result: Calibration) -> str:
    """One line on the stability runs, or nothing."""
    if not result.verdicts:
        return ""
    worst = max(result.verdicts, key=lambda verdict: verdict.residual)
    bad = [f"{v.cab} {v.dof}" for v in result.verdicts if not v.stable]
    return (
        f"velocity law, {len(result.verdicts)} step runs with the fitted values: "
        + (f"unstable in {', '.join(bad)}" if bad else "all stable")
        + f"; largest swing left {100 * worst.residual:.2f} % ({worst.cab}, {worst.dof})"
    )


def markdown(result: Calibration) -> str:
    """The tables as Markdown, for the data files of docs/reference/data.md."""
    parts = [table.markdown() for table in calibration_tables(result)]
    if result.verdicts:
        parts.append(f"{verdict_text(result).capitalize()}.\n")
    return "\n".join(parts)


def calibration_figure(calibration: Calibration) -> Figure:
    """Deviations over their tolerance, as shipped and as fitted."""
    pairs = [pair for pair in _pairs(calibration) if pair[0].deviation == pair[0].deviation]
    figure = new_figure(7.5, 1.3 + 0.21 * len(pairs), gridded=False)
    axes = figure.subplots()
    axes.axvspan(-1.0, 1.0, color="0.92")
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    for place, (first, last) in enumerate(pairs):
        colour = BLUE if first.role == "fitted" else ORANGE
        ends = [row.deviation / row.tolerance for row in (first, last)]
        axes.plot(ends, [place, place], color=colour, linewidth=0.8)
        axes.plot(ends[0], place, "o", color=colour, markerfacecolor="white", markersize=5)
        axes.plot(ends[1], place, "o", color=colour, markersize=5)
    labels = [
        f"{p.table.removeprefix('section ')} {p.law} {MEASURE_TITLES[p.measure]}" for p, _ in pairs
    ]
    axes.set_yticks(range(len(pairs)), labels, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("deviation from the print over its tolerance")
    phase, gain, zeta = (calibration.study.tolerance[measure] for measure in MEASURES)
    axes.set_title(
        f"Deviations from the print, {calibration.study.name} set\n"
        "open as shipped, full as fitted; blue fitted to, orange predicted; tolerance "
        f"{100 * phase:g} % (-90 deg), {100 * gain:g} % (-3 dB), "
        f"{zeta:g} (zeta)",
        fontsize=9,
    )
    return figure


def save_calibration(result: Calibration, folder: Path) -> list[Path]:
    """Write `residuals.png`, and the tables as `calibration.md`."""
    tables = partial(write_text, text=markdown(result))
    figure = calibration_figure(result)
    return save_files({"residuals.png": figure, "calibration.md": tables}, folder)
