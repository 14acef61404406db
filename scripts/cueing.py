"""Washouts judged side by side, and predictive cueing under load: `python scripts/cueing.py`.

Writes `cueing.csv`: means over the held-out drives, drawn by `SEEDS`, which nobody saw before the
settings were chosen, one row a family; and `all.csv`, a row for each manoeuvre and family. `--flood
SECONDS` writes `flood.csv`: random pushes and turns beyond the machine, live. `--record FILE` keeps
programmes, and `--solvers FILE` writes `solvers.csv`: times and failures on them of five
solvers, in an environment that has them. `softened` gives each the same programme, soft rows
written out; DAQP and OSQP begin at the solution before.

The classical and the optimal washout and the predictive one are those of `scripts/judgement.py
--workspace 0.22` (`cueing_*.toml`).
"""

import argparse
import csv
import gc
import pickle
import time
from collections.abc import Callable, Mapping
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from judgement import judge
from numpy.typing import NDArray
from scipy import sparse

from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.host.stream import make_stream
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.machine import load_machine
from cmf_mj.pilot.cueing import cue, excursion, within_limits
from cmf_mj.pilot.drives import DRIVES
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.motion import MOST_RATE
from cmf_mj.pilot.washout import Washout
from cmf_mj.pilot.washout_settings import PredictiveSettings, WashoutSettings, load_washout

SEEDS = (101, 102, 103, 104)
"""Of the drives held out: fixed after the settings."""

HELD_OUT = tuple(f"{name}:{seed}" for name in DRIVES for seed in SEEDS)

FLOWN = ("approach", "doublets", "engine_failure", "gusts", "take_off", "turbulence", "turn")

_HERE = Path(__file__).parent

Matrix = NDArray[np.float64]


def families() -> Mapping[str, WashoutSettings]:
    """The washouts to compare, by name."""
    base = load_washout("predictive")
    assert isinstance(base, PredictiveSettings)
    ahead = {
        f"predictive {reference}": base.model_copy(
            update={"prediction": base.prediction.model_copy(update={"reference": reference})}
        )
        for reference in ("constant", "guess", "known")
    }
    tuned = {name: load_washout(_HERE / f"cueing_{name}.toml") for name in ("classical", "optimal")}
    return {"simona": load_washout("simona"), **tuned, **ahead}


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows as CSV."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


SHOWN = {
    "force_error": ("error of the specific force sensed [m/s²]", ".3f"),
    "force_shape": ("shape", ".2f"),
    "force_scale": ("scale", ".2f"),
    "false_cues": ("false cues", ".0f"),
    "lasting": ("of 0.1 s or more", ".0f"),
    "tilting": ("time of turning noticed", ".2f"),
    "workspace": ("workspace", ".3f"),
    "mismatch": ("mismatch [m/s²]", ".2f"),
    "largest_share": ("largest share of a limit", ".2f"),
}
"""Columns of the table, titles and formats; those of `MOST` and `SUMMED` are no means."""
MOST, SUMMED = ("largest_share",), ("false_cues", "lasting")


def compare(out: Path, names: tuple[str, ...], rate: float) -> None:
    """Judge all families on all manoeuvres; means over those held out."""
    every: list[dict[str, Any]] = []
    table: list[dict[str, Any]] = []
    for family, settings in families().items():
        rows: list[dict[str, float]] = []
        for name in names:
            cued = cue(load_flight(name).motion, settings, rate=rate)
            row = judge(cued)._asdict() | {"largest_share": cued.excursion.largest}
            given = {key: f"{value:.5g}" for key, value in row.items()}
            every.append({"drive": name, "washout": family, **given})
            rows += [row] if name in HELD_OUT or not set(names) & set(HELD_OUT) else []
            print(", ".join(every[-1].values()), flush=True)
        columns: dict[str, Any] = {"washout": family}
        for key, (title, form) in SHOWN.items():
            values = np.array([row[key] for row in rows])
            joined = values.max() if key in MOST else values.mean()
            joined = values.sum() if key in SUMMED else joined
            columns[title] = f"{joined:{form}}"
            if key in ("force_error", "lasting", "workspace"):
                columns[f"{title}, change"] = joined
        table.append(columns)
        write(out / "all.csv", every)
    first = next(row for row in table if row["washout"] == "classical")
    for row in table[::-1]:
        for title in [title for title in row if title.endswith("change") and row is not first]:
            row[title] = f"{100.0 * (row[title] / first[title] - 1.0):+.0f} %"
    for title in [title for title in first if title.endswith("change")]:
        first[title] = "0 %"
    write(out / "cueing.csv", table)


def flood(out: Path, seconds: float) -> None:
    """Random pushes and turns, far beyond the machine, for some seconds of simulation."""
    rows = []
    for machine in ("cmf", "simona", "lab"):
        draw, count = np.random.default_rng(7), round(seconds * MOST_RATE)
        cab = load_cab(None, load_machine(machine))
        washout = Washout("predictive", cab=cab)
        washout.solving = 0.0  # times are the processor's: another program's are not the solver's
        motions = np.empty((count, 3, 6))
        gc.disable()
        cpu = np.empty(count)
        for row in range(count):
            if row % 40 == 0:
                push = 30.0 * draw.normal(size=3) - [0.0, 0.0, STANDARD_GRAVITY]
                turn = 2.0 * draw.normal(size=3)
            begun = time.process_time()
            motions[row] = washout.frame(push, turn)[2:]
            cpu[row] = time.process_time() - begun
        gc.enable()
        assert washout.predictive is not None
        solves = washout.predictive.solves
        taken = 1e3 * cpu[1:]
        stream = make_stream(np.arange(count) / MOST_RATE, *motions.swapaxes(0, 1))
        use = excursion(stream, None, machine)
        sent, held = within_limits(stream, None, machine)
        kept = excursion(sent, None, machine)
        rows.append(
            {
                "machine": machine,
                "frames": count,
                "largest_share": f"{use.largest:.4f}",
                "of": use.binding,
                "frames_limited": int(held.sum()),
                "largest_share_sent": f"{kept.largest:.4f}",
                "not_finite": int((~np.isfinite(motions)).sum()),
                "bridged": sum(solves.bridged),
                "late": int((taken > 1e3 / MOST_RATE).sum()),
                "late_percent": f"{100 * np.mean(taken > 1e3 / MOST_RATE):.3g}",
                "median_ms": f"{np.median(taken):.3g}",
                "p95_ms": f"{np.quantile(taken, 0.95):.3g}",
                "p999_ms": f"{np.quantile(taken, 0.999):.3g}",
                "worst_ms": f"{taken.max():.3g}",
                "most_iterations": max(solves.iterations),
            }
        )
        print(rows[-1], flush=True)
        write(out / "flood.csv", rows)


def draw_plan(out: Path) -> None:
    """The horizon and the legs in braking to rest: what is felt, and plans of a leg."""
    from cmf_mj.machine.kinematics import pose_to_legs
    from cmf_mj.machine.motion_limits import load_motion_limits

    figure, (force, leg) = plt.subplots(1, 2, figsize=(9.0, 3.2), layout="constrained")
    flown = load_flight("braking").motion
    shown = families()
    for family, colour in zip(
        ("classical", "predictive guess", "predictive known"), "C7 C0 C1".split(), strict=True
    ):
        cued = cue(flown, shown[family])
        time = cued.aircraft.time
        if family == "classical":
            force.plot(time, cued.error.aircraft.specific_force[:, 0], "k", lw=1.0, label="car")
        force.plot(time, cued.error.simulator.specific_force[:, 0], colour, label=family)
        longest = pose_to_legs(cued.stream.pose) / load_motion_limits().leg.position.si
        leg.plot(time, np.abs(longest).max(axis=1), colour)
    force.set(xlabel="time [s]", ylabel="specific force forwards, sensed [m/s²]", xlim=(4.0, 36.0))
    leg.set(
        xlabel="time [s]", ylabel="longest leg over its limit", xlim=(4.0, 36.0), ylim=(0.0, 1.05)
    )
    leg.axhline(1.0, color="0.5", ls=":")
    force.legend()
    figure.savefig(out / "predictive.png", dpi=130)


RECORDED = ("braking", "urban", "slalom")
"""Drives whose programmes solvers are timed on, one frame in 240."""


def record(path: Path) -> None:
    """Programmes that the predictive washout solves on some drives."""
    kept: list[dict[str, Matrix]] = []
    for name in RECORDED:
        washout = Washout("predictive")
        own, count = washout.predictive, 0
        assert own is not None
        solver, solve = own.solver, own.solver.solve
        prices = {"price": solver.prices.linear, "ease": solver.prices.ease}

        def solving(programme: dict[str, Matrix]) -> Any:
            nonlocal count
            count += 1
            if count % 240 == 0:
                kept.append({**programme, **prices})  # noqa: B023
            return solve(programme)  # noqa: B023

        solver.solve = solving  # type: ignore[method-assign]
        washout.run(load_flight(name).motion)
    with path.open("wb") as file:
        pickle.dump(kept, file)


def softened(programme: dict[str, Matrix]) -> tuple[Any, Matrix, Any, Matrix, Matrix]:
    """P, q, G, l, h of min x^T P x / 2 + q^T x, l <= G x <= h; x = (z, by what rows are passed)."""
    a, price, many = programme["A"], programme["price"], len(programme["A"])
    unit, none = sparse.eye(many), np.full(many, np.inf)
    weight = sparse.diags(
        np.concatenate([np.ones(a.shape[1]), 1.0 / programme["ease"]]), format="csc"
    )
    rows = sparse.bmat(
        [[sparse.csc_matrix(a), -unit], [sparse.csc_matrix(a), unit], [None, unit]], format="csc"
    )
    lows = np.concatenate([-none, programme["blower"], np.zeros(many)])
    highs = np.concatenate([programme["bupper"], none, none])
    return weight, np.concatenate([programme["f"], price]), rows, lows, highs


def by_daqp() -> Callable[[dict[str, Matrix]], Matrix | None]:
    """As the project solves them: soft rows, warm."""
    daqp = import_module("daqp")

    solver, ready = daqp.Model(), False

    def solve(p: dict[str, Matrix]) -> Matrix | None:
        nonlocal ready
        given = {key: p[key] for key in ("f", "A", "bupper", "blower")}
        if ready:
            solver.update(**given)
        else:
            soft = np.full(len(p["A"]), 8, dtype=np.int32)
            solver.setup(np.eye(len(p["f"])), sense=soft, **given)
            price, ease = p["price"], p["ease"]
            solver.soft_weights(w_l=price, w_u=price, rho_l=ease, rho_u=ease)
            ready = True
        z, _, flag, _ = solver.solve()
        return z if flag in (1, 2) else None

    return solve


def by_osqp() -> Callable[[dict[str, Matrix]], Matrix | None]:
    """Warm from the programme before."""
    osqp = import_module("osqp")

    before: list[Any] = []

    def solve(p: dict[str, Matrix]) -> Matrix | None:
        weight, q, rows, low, high = softened(p)
        solver = osqp.OSQP()
        how = {"verbose": False, "eps_abs": 1e-5, "eps_rel": 1e-5, "max_iter": 4000}
        solver.setup(sparse.triu(weight, format="csc"), q, rows, low, high, **how)
        if before:
            solver.warm_start(x=before[0].x, y=before[0].y)
        found = solver.solve()
        before[:] = [found]
        return np.asarray(found.x) if found.info.status == "solved" else None

    return solve


def by_piqp() -> Callable[[dict[str, Matrix]], Matrix | None]:
    """Interior point, cold."""
    piqp = import_module("piqp")

    def solve(p: dict[str, Matrix]) -> Matrix | None:
        weight, q, rows, low, high = softened(p)
        solver = piqp.SparseSolver()
        free = np.full(len(q), np.inf)
        solver.setup(weight, q, None, None, rows, low, high, -free, free)
        return np.asarray(solver.result.x) if solver.solve() == piqp.PIQP_SOLVED else None

    return solve


def by_proxqp() -> Callable[[dict[str, Matrix]], Matrix | None]:
    """Augmented Lagrangian, cold."""
    proxsuite = import_module("proxsuite")

    def solve(p: dict[str, Matrix]) -> Matrix | None:
        weight, q, rows, low, high = softened(p)
        solver = proxsuite.proxqp.sparse.QP(len(q), 0, rows.shape[0])
        solver.settings.eps_abs, solver.settings.max_iter = 1e-5, 1000
        solver.init(weight, q, None, None, rows, low, high)
        solver.solve()
        good = solver.results.info.status == proxsuite.proxqp.PROXQP_SOLVED
        return np.asarray(solver.results.x) if good else None

    return solve


def by_clarabel() -> Callable[[dict[str, Matrix]], Matrix | None]:
    """Interior point, cold."""
    clarabel = import_module("clarabel")

    def solve(p: dict[str, Matrix]) -> Matrix | None:
        weight, q, rows, low, high = softened(p)
        up, down = np.isfinite(high), np.isfinite(low)
        whole = sparse.vstack([rows[up], -rows[down]], format="csc")
        bound, how = np.concatenate([high[up], -low[down]]), clarabel.DefaultSettings()
        how.verbose = False
        cone = [clarabel.NonnegativeConeT(len(bound))]
        found = clarabel.DefaultSolver(
            sparse.triu(weight, format="csc"), q, whole, bound, cone, how
        ).solve()
        return np.array(found.x) if str(found.status) == "Solved" else None

    return solve


SOLVERS = {
    "DAQP": by_daqp,
    "OSQP": by_osqp,
    "PIQP": by_piqp,
    "ProxQP": by_proxqp,
    "Clarabel": by_clarabel,
}


def price_of(p: dict[str, Matrix], z: Matrix) -> float:
    """Cost of a programme at z."""
    reached = p["A"] @ z
    passed = np.maximum(np.maximum(reached - p["bupper"], p["blower"] - reached), 0.0)
    return float(0.5 * z @ z + p["f"] @ z + p["price"] @ passed + np.sum(passed**2 / p["ease"]) / 2)


def time_solvers(path: Path, out: Path) -> None:
    """Times and failures of the solvers that can be imported, on recorded programmes."""
    with path.open("rb") as file:
        programmes = pickle.load(file)
    best, rows = None, []
    for name, make_solver in SOLVERS.items():
        solve, taken, costs, failed = make_solver(), [], [], 0
        for p in programmes:
            begun = time.process_time()
            z = solve(p)
            taken.append(1e3 * (time.process_time() - begun))
            failed += z is None
            costs.append(np.inf if z is None else price_of(p, z[: len(p["f"])]))
        best = np.array(costs) if best is None else best
        off = (np.array(costs) - best) / np.maximum(np.abs(best), 1.0)
        shares = (f"{np.quantile(taken, q):.3g}" for q in (0.5, 0.95, 1.0))
        version = metadata.version(name.lower().replace("proxqp", "proxsuite"))
        row = {"solver": name, "version": version, "programmes": len(programmes)}
        row |= dict(zip(("median_ms", "p95_ms", "worst_ms"), shares, strict=True))
        late, dearer = np.array(taken) > 1e3 / MOST_RATE, off[np.isfinite(off)] > 1e-3
        row |= {"beyond_frame": int(late.sum()), "failed": failed, "dearer": int(dearer.sum())}
        print(row, flush=True)
        rows.append(row)
        write(out / "solvers.csv", rows)


def main() -> None:
    """Compare, flood or time solvers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=float, default=MOST_RATE, help="frames a second")
    parser.add_argument("--only", nargs="*", help="manoeuvres, in place of those held out")
    parser.add_argument("--flown", action="store_true", help="the shipped flights and drives too")
    parser.add_argument("--flood", type=float, metavar="SECONDS")
    parser.add_argument("--record", type=Path, metavar="FILE", help="programmes of some drives")
    parser.add_argument("--solvers", type=Path, metavar="FILE", help="time solvers on that file")
    parser.add_argument("--picture", action="store_true", help="draw predictive.png")
    parser.add_argument("--out", type=Path, default=Path("out/cueing"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.flood:
        flood(options.out, options.flood)
    elif options.picture:
        draw_plan(options.out)
    elif options.record:
        record(options.record)
    elif options.solvers:
        time_solvers(options.solvers, options.out)
    else:
        seen = (*FLOWN, *DRIVES) if options.flown else ()
        compare(options.out, tuple(options.only or (*HELD_OUT, *seen)), options.rate)


if __name__ == "__main__":
    main()
