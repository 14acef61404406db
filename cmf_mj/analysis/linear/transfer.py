"""A python-control transfer function that knows the units of its input and output."""

from collections.abc import Sequence
from typing import Any

import control

from cmf_mj.core import units


class UnitTransferFunction(control.TransferFunction):  # type: ignore[misc]
    """A SISO transfer function with units; arithmetic gives plain transfer functions.

    Its gain counts in `output_unit` per `input_unit`, units of `cmf_mj.core.units`.
    """

    def __init__(
        self,
        numerator: Sequence[float],
        denominator: Sequence[float],
        dt: float = 0.0,
        *,
        input_unit: str,
        output_unit: str,
        **keywords: Any,
    ) -> None:
        """Wrap polynomials of s, or of z with a sampling time `dt` [s], highest power first.

        Args:
            numerator: coefficients.
            denominator: coefficients.
            dt: sampling time [s]; 0 for continuous time.
            input_unit: unit of the input.
            output_unit: unit of the output.
            keywords: `inputs`, `outputs` and `name` of python-control.

        Raises:
            InputError: a unit is not known.
        """
        units.factor(input_unit), units.factor(output_unit)
        super().__init__(list(numerator), list(denominator), dt, **keywords)
        self.input_unit = input_unit
        """Unit of the input."""
        self.output_unit = output_unit
        """Unit of the output."""

    @property
    def si_factor(self) -> float:
        """What the gain is multiplied with to count in SI units and command fractions."""
        return units.factor(self.output_unit) / units.factor(self.input_unit)

    def to_si(self) -> control.TransferFunction:
        """The same system in SI units, commands as fractions; labels are kept."""
        return control.tf(
            self.num_array[0, 0] * self.si_factor,
            self.den_array[0, 0],
            self.dt,
            inputs=self.input_labels,
            outputs=self.output_labels,
            name=self.name,
        )
