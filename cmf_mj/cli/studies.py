"""Studies: `cmf study`, `tune`, `certify`; the 2014 report: `cmf report` and what is below it."""

from __future__ import annotations

import os
import sys
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Context, Option

import cmf_mj
from cmf_mj.cli import options
from cmf_mj.cli.common import app, claim, friction_option, progress_bar, show, written_text
from cmf_mj.cli.options import any_argument, choice, name_or_file, new_file
from cmf_mj.core.errors import require

command = partial(app.command, rich_help_panel="Studies")
drawing = options.drawing(command)

_BACKEND, _FORMS = "studies.engine:Backend", "studies.tuning.forms:FORMS"
_BACKENDS = "threading, loky (processes) or dask"
_READY, _TUNED = "studies.settings:STUDIES", Path("out/tune/law.toml")
_FORM_HELP = (
    "law whose gains to search: modal_plan, modal, velocity, pressure, feed_forward, acceleration"
)

Laws = Annotated[list[str] | None, name_or_file(options.LAWS, "LAWS", "instead of the study's")]
OtherCabs = Annotated[
    list[str] | None,
    name_or_file(options.CABS, "CABS", "instead of the study's", source_of_all="cli.options:ALL"),
]
OtherDofs = Annotated[list[str] | None, choice(options.DOFS, "DOFS", "instead of the study's")]


@drawing("study")
def study_command(
    context: Context,
    specification: Annotated[str, any_argument(_READY, "STUDY", "name or TOML file")],
    out: options.NamedOut = None,
    machine: options.OtherMachine = None,
    laws: Laws = None,
    cabs: OtherCabs = None,
    dofs: OtherDofs = None,
    draws: Annotated[int | None, Option(help="random samples of the machine")] = None,
    quick: options.Quick = False,
    jobs: options.Jobs = None,
    backend: Annotated[str, choice(_BACKEND, "BACKEND", _BACKENDS)] = "loky",
    scheduler: Annotated[str | None, Option(help="address of a running Dask scheduler")] = None,
) -> None:
    """Run a study of many cases, or what is left of it; the same command resumes it."""
    from cmf_mj.report_2014.posterior.answers import posterior_tables
    from cmf_mj.report_2014.posterior.effect_run import run_effects
    from cmf_mj.report_2014.posterior.effect_tables import effect_tables
    from cmf_mj.report_2014.posterior.figures import posterior_figures
    from cmf_mj.report_2014.posterior.run import run_posterior
    from cmf_mj.report_2014.posterior.study import load_effects, load_posterior
    from cmf_mj.show import study as report
    from cmf_mj.show.look import save_files
    from cmf_mj.studies.engine import RESULTS, run_study
    from cmf_mj.studies.settings import load_study, study_table

    workers: dict[str, Any] = {"jobs": os.cpu_count() or 1 if jobs is None else jobs}
    workers |= {"backend": "dask" if scheduler else backend, "scheduler": scheduler}
    entries = {"machine": machine, "cabs": cabs, "dofs": dofs, "draws": draws}
    changes: dict[str, Any] = {key: value for key, value in entries.items() if value is not None}
    out = claim(context, out or Path("out") / Path(specification).stem)
    tables, figures = dict[str, Any](), dict[str, Any]()
    try:
        with progress_bar() as update:
            specification_table, _ = study_table(specification)
            if "effects" in specification_table:
                effects = load_effects(specification, laws=laws, changes=changes, quick=quick)
                tables = effect_tables(run_effects(effects, out, progress=update, **workers))
            elif "unknowns" in specification_table:
                posterior = load_posterior(specification, laws=laws, changes=changes, quick=quick)
                results = run_posterior(posterior, out, progress=update, **workers)
                tables, figures = posterior_tables(results), posterior_figures(results)
            else:
                changes |= {"quick": True} if quick else {}
                study = load_study(specification, laws=laws, changes=changes)
                table = run_study(study, out, progress=update, **workers)
                show(report.summary_table(table))
                paths = [out / RESULTS, *report.save_report(table, out)]
        if tables:
            show(*[*tables.values()][:2])  # of the others many have more rows than a screen
            kinds = product(tables, ("md", "csv"))
            files = {f"{name}.{kind}": tables[name].table for name, kind in kinds}
            paths = save_files(files | figures, out, 90)
        show(written_text(paths, out))
    except KeyboardInterrupt:
        typer.secho(f"cmf: interrupted; the same command continues {out}", err=True)
        if workers["backend"] == "threading":
            sys.stderr.flush()
            os._exit(130)  # threads still compute: they would outlive what they compute on
        raise SystemExit(130) from None


@command("tune")
def tune_command(
    name: Annotated[str | None, Option(help="name of the law; default FORM_tuned")] = None,
    form: Annotated[str, choice(_FORMS, "FORM", _FORM_HELP)] = "modal_plan",
    peak: Annotated[float, Option(help="largest peak gain [dB]")] = 2.0,
    overshoot: Annotated[float, Option(help="largest overshoot of a step [%]")] = 18.0,
    machine: options.Machine = "cmf",
    cabs: options.Cabs = options.ALL,
    friction: options.Friction = None,
    evaluations: Annotated[int, Option(help="laws to try, about")] = 24,
    seed: options.Seed = 1,
    target: Annotated[Path, new_file("--file", help="law file to write")] = _TUNED,
) -> None:
    """Search the gains of a form of law over all cabs and axes, on linear plants."""
    from cmf_mj.machine.models import CMF
    from cmf_mj.studies.tuning.evaluation import least_damping
    from cmf_mj.studies.tuning.forms import make_template
    from cmf_mj.studies.tuning.search import Requirements, save_law, search

    limits = Requirements(peak, overshoot / 100.0)
    name = name or f"{form}_tuned"
    title = name.replace("_", " ").capitalize()
    template = make_template(name, title, cabs, friction_option(friction))
    effort: dict[str, Any] = {"form": form, "evaluations": evaluations, "seed": seed}
    with progress_bar() as update:
        result = search(template, limits, progress=update, **effort)
    cab_names = ",".join(cab.carrier.name for cab in template.cabs)
    base = cmf_mj.load_cab(cabs[0]).machine.name
    machine_text = "" if base == CMF else f"--machine {base} "
    command_line = (
        f"cmf tune {machine_text}--form {form} --peak {peak:g} --overshoot {overshoot:g} "
        f"--cabs {cab_names} --evaluations {evaluations} --seed {seed}"
        + ("" if friction is None else f" --friction {friction}")
    )
    law = result.law.model_copy(update={"source": f"this project: {command_line}"})
    save_law(law, target, f"Written by `{command_line}`.")
    performance = result.performance
    show(
        f"linear plants, worst of all cabs, degrees of freedom and valve gains: "
        f"-90 deg {performance.phase_hz.min():.2f} Hz, peak {performance.peak_db.max():.2f} dB, "
        f"overshoot {100.0 * performance.overshoot.max():.1f} %, least damping ratio "
        f"{least_damping(law, template.frictionless):.3f}; {result.verdict}",
        f"{result.evaluations} laws tried; written to {target}",
        f"what the simulation gives: cmf compare {machine_text}--laws {target}",
    )


@drawing("certify")
def certify_command(
    laws: Annotated[list[str], any_argument(options.LAWS, "LAWS...", "by name or TOML file")],
    machine: options.Machine = "cmf",
    cabs: options.Cabs = options.ALL,
    hydraulics: options.Hydraulics = "hardware",
    box: Annotated[Path | None, options.file(help="unit box; default tolerances as bought")] = None,
    friction: options.Friction = None,
    quick: options.Quick = False,
    seed: options.Seed = 1,
    out: options.Out = Path("out/certify"),
) -> None:
    """Bound how far machines may be off before a law fails, and find machines that break it."""
    from cmf_mj.core.settings import check_distinct
    from cmf_mj.plant.cylinder import contact_text
    from cmf_mj.show import study as report
    from cmf_mj.show.look import save_files
    from cmf_mj.studies import certificate
    from cmf_mj.studies.certificate_box import load_box
    from cmf_mj.studies.engine import one_library_thread

    unit_box = load_box(box)
    effort = (certificate.QUICK if quick else certificate.Effort())._replace(seed=seed)
    contacts = (
        [friction_option(text.strip()) for text in friction.split(",")] if friction else [None]
    )
    plants = [cmf_mj.Hexapod(cab, hydraulics) for cab in cabs]
    loaded_laws = [cmf_mj.load_law(law) for law in laws]
    check_distinct("laws", [law.name for law in loaded_laws])
    check_distinct("cabs", [plant.cab for plant in plants])
    certificates = []
    with progress_bar() as update:
        cases = list(product(loaded_laws, plants, contacts))
        update(0, len(cases))
        for law, plant, contact in cases:
            folder = out / law.name / plant.cab
            if len(contacts) > 1:
                folder /= contact_text(contact).replace(" m/s", "")
            with one_library_thread():  # so that the same seed gives the same bits
                proof = certificate.certify(plant, law, folder, unit_box, effort, contact)
            certificates.append(proof)
            update(len(certificates), len(cases))
    tables = certificate.certificate_tables(certificates)
    files = {f"{name}.{kind}": tables[name] for name, kind in product(tables, ("md", "csv"))}
    figure = {"certificates.png": report.certificate_figure(certificates)}
    show(*tables.values(), written_text(save_files(files | figure, out), out))


reports = typer.Typer()
app.add_typer(reports, name="report", rich_help_panel="The report")

_NUMBERS = "by number with commas between, `all` or `none`"


def _numbers(text: str) -> list[str] | None:
    """Numbers of a comma-separated option; None for all."""
    if text == "all":
        return None
    return [part.strip() for part in text.split(",") if part.strip() not in ("", "none")]


@reports.callback(invoke_without_command=True)
def report_command(
    context: Context,
    figures: Annotated[str, Option(metavar="NUMBERS", help=f"figures {_NUMBERS}")] = "all",
    tables: Annotated[str, Option(metavar="NUMBERS", help=f"result tables {_NUMBERS}")] = "all",
    jobs: options.Jobs = None,
    out: options.NamedOut = None,
    quick: options.Quick = False,
) -> None:
    """Reproduce the 2014 report on one HTML page, printed results next to ours."""
    if context.invoked_subcommand is not None:
        return
    require("jinja2", "report")
    from cmf_mj.report_2014.page.document import make_content, save_page, verdict_tables

    folder = claim(context, out or Path("out/report"))
    with progress_bar() as update:
        content = make_content(
            _numbers(figures), _numbers(tables), jobs=jobs, quick=quick, progress=update
        )
    path = save_page(content, folder)
    size = path.stat().st_size / 1e6
    parts = [part.table for part in verdict_tables(content)]
    show(*parts, f"written to {path}: {len(content.figures)} figures, {size:.1f} MB")


@reports.command("ledger")
def ledger_command(
    number: Annotated[int | None, Argument(help="number of an entry; default all")] = None,
) -> None:
    """Show the misprints and contradictions of the report and what is done about each."""
    from cmf_mj.report_2014.ledger import ledger_entry, ledger_table, load_ledger

    show(ledger_table(load_ledger() if number is None else (ledger_entry(number),)))


@options.drawing(reports.command)("linear")
def linear_command(
    laws: options.Laws = options.VELOCITY, out: options.Out = Path("out/linear")
) -> None:
    """Show Table 4-1 computed, and laws around the report's linear models."""
    from cmf_mj.report_2014 import model_tables as linear

    loops, rows = linear.law_loops(laws), linear.table_4_1()
    paths = linear.save_linear(loops, rows, out)
    show(rows, loops, written_text(paths, out))
