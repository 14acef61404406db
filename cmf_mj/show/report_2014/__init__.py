"""The 2014 report reproduced on one page: its figures and tables from our own runs, print beside.

`make_content` makes the runs, `save_page` writes the page. `FIGURES` and `TABLES` are what it can
show, `sections.SECTIONS` how it is ordered.
"""

from cmf_mj.show.report_2014.page import (
    FIGURES,
    TABLES,
    chosen_figures,
    chosen_tables,
    make_content,
    render,
    save_page,
    sections_of,
)
from cmf_mj.show.report_2014.tables import outside, result_rows

__all__ = [
    "FIGURES",
    "TABLES",
    "chosen_figures",
    "chosen_tables",
    "make_content",
    "outside",
    "render",
    "result_rows",
    "save_page",
    "sections_of",
]
