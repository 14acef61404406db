"""`cmf tune`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import app, names_of, progress_bar, refuse, show
from cmf_mj.studies.tuning.files import save_law
from cmf_mj.studies.tuning.forms import FORMS, make_template
from cmf_mj.studies.tuning.nominal import CABS
from cmf_mj.studies.tuning.search import Limits, search


@app.command("tune")
def tune_command(
    name: Annotated[str, typer.Option(help="name of the law")] = "modal_plan",
    form: Annotated[str, typer.Option(help=", ".join(FORMS))] = "modal_plan",
    title: Annotated[str, typer.Option(help="its title")] = "Modal plan",
    peak: Annotated[float, typer.Option(help="largest peak gain [dB]")] = Limits().peak_db,
    overshoot: Annotated[float, typer.Option(help="largest overshoot of a step [%]")] = 100.0
    * Limits().overshoot,
    cabs: Annotated[str, typer.Option(help="cabs it is for, comma-separated, or `all`")] = "all",
    evaluations: Annotated[int, typer.Option(help="laws to try, about")] = 24,
    seed: Annotated[int, typer.Option(help="of the search")] = 1,
    out: Annotated[Path, typer.Option(help="law file to write")] = Path("out/tune/law.toml"),
) -> None:
    """Search the gains of a form of law over all cabs and degrees of freedom."""
    limits = Limits(peak_db=peak, overshoot=overshoot / 100.0)
    try:
        with progress_bar() as update:
            found = search(
                make_template(name, title, names_of(cabs, CABS)),
                limits,
                form=form,
                evaluations=evaluations,
                seed=seed,
                progress=update,
            )
        said = (
            f"cmf tune --form {form} --peak {peak:g} --overshoot {overshoot:g} --cabs {cabs} "
            f"--evaluations {evaluations} --seed {seed}"
        )
        law = found.law.model_copy(update={"source": f"this project: {said}"})
        target = save_law(law, out, f"Written by `{said}`.")
    except (ValueError, OSError, ImportError) as error:
        refuse(error)
    worth = found.worth
    show(
        f"linear plants, worst of all cabs, degrees of freedom and valve gains: "
        f"-90 deg {worth.phase_hz.min():.2f} Hz, peak {worth.peak_db.max():.2f} dB, "
        f"overshoot {100.0 * worth.overshoot.max():.1f} %",
        f"{found.evaluations} laws tried; written to {target}",
    )
