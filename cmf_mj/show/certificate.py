"""Certificates as tables and a figure."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.show import look
from cmf_mj.show.table import Table
from cmf_mj.studies.certificate.run import Certificate


def certificate_table(certificates: Sequence[Certificate]) -> Table:
    """One row a law and cab: nominal damping, scales, machines drawn, and the replays."""
    columns = (
        *("law", "cab", ("zeta", ".3f"), ("proven", ".2g"), ("broken", ".2g"), "breaks at"),
        *(("stable", ".1f %"), ("least zeta", ".3f")),
        *(("beyond", ".0f %"), ("within", ".1f %")),
    )
    rows = [
        (
            *(
                one.law,
                one.cab,
                one.nominal,
                one.proven,
                one.broken,
                look.pose_text(one.pose, ".2g"),
            ),
            *(100.0 * one.share, one.least, 100.0 * one.beyond, 100.0 * one.within),
        )
        for one in certificates
    ]
    return Table("", columns, rows)


def proof_table(certificates: Sequence[Certificate]) -> Table:
    """One row a damping ratio: the box in which it is proven, and the least found there."""
    columns = (
        "law",
        "cab",
        *((name, ".3f") for name in ("zeta", "proven box", "least zeta found")),
    )
    rows = [(one.law, one.cab, *proof) for one in certificates for proof in one.proofs]
    return Table("", columns, rows)


def certificate_figure(certificates: Sequence[Certificate]) -> Figure:
    """Boxes of all laws: what is proven, what is not known, and where machines fail."""
    figure = look.new_figure(7.0, 1.2 + 0.32 * len(certificates))
    axes = figure.add_subplot()
    proven = np.array([one.proven for one in certificates])
    broken = np.array([one.broken for one in certificates])
    most = 1.15 * float(np.nanmax([*proven, *broken, 1.0]))
    place, open_end = np.arange(len(certificates)), np.where(np.isnan(broken), most, broken)
    axes.barh(place, proven, color=look.GREEN, label="proven stable")
    axes.barh(place, open_end - proven, left=proven, color=look.PALE, label="neither")
    axes.barh(place, most - open_end, left=open_end, color=look.ORANGE, label="machines fail")
    axes.axvline(1.0, color=look.DARK, linestyle="--")
    axes.set(yticks=place, xlim=(0.0, most), xlabel="scale of the unit box")
    axes.set_yticklabels([f"{one.law}, {one.cab}" for one in certificates])
    axes.invert_yaxis()
    axes.set_title("Boxes of machines that are proven stable", pad=28)
    look.legend(axes, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return figure
