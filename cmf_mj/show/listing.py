"""Tables of what ships: laws, hydraulic and sensor sets, and the ledger of the report's errors."""

from collections.abc import Sequence

from cmf_mj.analysis.ledger import LedgerEntry
from cmf_mj.control.law import Law
from cmf_mj.electronics.sensors.settings import CHANNELS, SensorSettings
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.show.table import Table


def law_table(laws: Sequence[Law]) -> Table:
    """Laws with their sources."""
    rows = [(law.name, law.title, law.source) for law in laws]
    return Table("control laws", ("name", "title", "source"), rows)


def parameter_table(parameters: HydraulicParameters) -> Table:
    """A hydraulic set: value, unit, status and source of every number."""
    rows = [
        (name, quantity.value, quantity.unit, quantity.status, quantity.source)
        for name, quantity in parameters.quantities().items()
    ]
    columns = ("parameter", ("value", "g"), "unit", "status", "source")
    return Table(f"hydraulics: {parameters.name}", columns, rows)


def sensor_table(settings: SensorSettings) -> Table:
    """A sensor set with the unit, status and source of every number."""
    rows: list[tuple[str | float, ...]] = []
    for channel in CHANNELS:
        numbers = settings.channel(channel).quantities()
        if not numbers:
            rows.append((channel, "ideal", "", "", "", ""))
        rows += [
            (channel, name, each.value, each.unit, each.status, each.source)
            for name, each in numbers.items()
        ]
    gravity = "on" if settings.gravity else "off"
    columns = ("channel", "number", ("value", "g"), "unit", "status", "source")
    return Table(f"sensors: {settings.name}, gravity {gravity}", columns, rows)


def figures_text(entry: LedgerEntry) -> str:
    """The figures of an entry in one line."""
    return "; ".join(str(figure) for figure in entry.figures)


def ledger_table(entries: Sequence[LedgerEntry]) -> Table:
    """One row an entry: what is printed, what is wrong with it, what the project does."""
    columns = (("no.", ""), "where", "printed", "finding", "figures", "what we do")
    rows = [
        (str(one.number), one.where, one.printed, one.finding, figures_text(one), one.project)
        for one in entries
    ]
    return Table("misprints and contradictions of the report", columns, rows, ruled=True)
