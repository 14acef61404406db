"""Certificates as tables and a figure."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.core.table import Table
from cmf_mj.show import look
from cmf_mj.studies.certificate.run import Certificate


def certificate_table(certificates: Sequence[Certificate]) -> Table:
    """One row a law and cab: nominal damping, scales, machines drawn, and the replays."""
    kept = ("law", "cab", ("zeta", ".3f"), ("proven", ".2g"), ("broken", ".2g"), "breaks at")
    drawn = (("stable", ".1f %"), ("least zeta", ".3f"), ("peak [dB]", ".1f"), ("highest", ".1f"))
    rows = []
    for one in certificates:
        where, swings = look.pose_text(one.pose, ".2g"), (100.0 * one.beyond, 100.0 * one.within)
        scales = one.law, one.cab, one.nominal, _down(one.proven), one.broken, where
        rows.append((*scales, 100.0 * one.share, one.least, one.peak, one.highest, *swings))
    return Table("", (*kept, *drawn, ("beyond", ".0f %"), ("within", ".1f %")), rows)


def _down(scale: float) -> float:
    """A scale to two digits, never more than it is."""
    digit = 10.0 ** (np.floor(np.log10(scale)) - 1.0) if scale > 0.0 else 1.0
    return float(np.floor(scale / digit) * digit)


def proof_table(certificates: Sequence[Certificate]) -> Table:
    """One row a damping ratio: the box in which it is proven, and the least found there."""
    numbers = ((name, ".3f") for name in ("zeta", "proven box", "least zeta found"))
    rows = [(one.law, one.cab, *proof) for one in certificates for proof in one.proofs]
    return Table("", ("law", "cab", *numbers), rows)


def certificate_figure(certificates: Sequence[Certificate]) -> Figure:
    """Boxes of all laws: what is proven, what is not known, and where machines fail."""
    figure = look.new_figure(7.0, 1.2 + 0.32 * len(certificates))
    axes = figure.add_subplot()
    proven, broken = np.array([(one.proven, one.broken) for one in certificates]).T
    most = 1.15 * float(np.nanmax([*proven, *broken, 1.0]))
    ends = np.array([0.0 * proven, proven, np.where(np.isnan(broken), most, broken)])
    widths, place = np.diff(ends, axis=0, append=most), np.arange(len(certificates))
    colours = look.GREEN, look.PALE, look.ORANGE
    labels = "proven stable", "neither", "machines fail"
    for left, wide, colour, label in zip(ends, widths, colours, labels, strict=True):
        axes.barh(place, wide, left=left, color=colour, label=label)
    axes.axvline(1.0, color=look.DARK, linestyle="--")
    axes.set(xlim=(0.0, most), xlabel="scale of the unit box")
    axes.set_yticks(place, [f"{one.law}, {one.cab}" for one in certificates])
    axes.invert_yaxis()
    axes.set_title("Boxes of machines that are proven stable", pad=28)
    look.legend(axes, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return figure
