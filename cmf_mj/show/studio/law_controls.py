"""Controls of the law: shipped ones, one from a file, and a slider for each of its gains."""

import tempfile
from pathlib import Path

import viser

from cmf_mj.control.law import Law, law_names, load_law
from cmf_mj.core.errors import InputError
from cmf_mj.facility.scenario.settings import Change, change_of
from cmf_mj.show.studio.desk import Desk, by_hand, picked
from cmf_mj.show.studio.gains import Knob, knobs, law_as_gains

_STEPS = 200
"""Steps of a slider from end to end."""


class LawControls:
    """The law and its gains."""

    def __init__(self, desk: Desk) -> None:
        """Add them to the container in force."""
        self._desk = desk
        self._files: dict[str, Law] = {}
        gui = desk.client.gui
        self._law = gui.add_dropdown("law", law_names(), initial_value="velocity")
        upload = gui.add_upload_button("law from a file", mime_type=".toml", icon="upload")
        self._folder = gui.add_folder("gains", expand_by_default=False)
        self._sliders: list[viser.GuiSliderHandle[float]] = []
        self._show_gains(load_law("velocity"))

        @self._law.on_update
        def _(event: viser.GuiEvent[viser.GuiDropdownHandle[str]]) -> None:
            if by_hand(event):
                self._choose(event.target.value)

        @upload.on_upload
        def _(event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
            try:
                law = _uploaded(event.target.value)
            except ValueError as error:
                desk.tell(error)
                return
            option = f"{law.name} (file)"
            self._files[option] = law
            picked(self._law, option)
            self._choose(option)

    def sync(self, name: str, law: Law) -> None:
        """Show a law that did not come from these controls.

        Args:
            name: as the scenario has it.
            law: with its gains.
        """
        picked(self._law, name)
        self._show_gains(law)

    def _choose(self, option: str) -> None:
        law = self._files.get(option)
        table = {"law": option} if law is None else law_as_gains(law)
        self._desk.apply(change_of(table, "law"))
        self._show_gains(law or load_law(option))

    def _show_gains(self, law: Law) -> None:
        for slider in self._sliders:
            slider.remove()
        self._sliders.clear()
        with self._folder:
            for knob in knobs(law):
                self._sliders.append(self._slider(knob))

    def _slider(self, knob: Knob) -> viser.GuiSliderHandle[float]:
        slider = self._desk.client.gui.add_slider(
            knob.label,
            knob.low,
            knob.high,
            (knob.high - knob.low) / _STEPS,
            knob.value,
            hint=knob.hint,
        )

        @slider.on_update
        def _(event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
            if by_hand(event):
                value = event.target.value
                self._desk.later(
                    ".".join(knob.path),
                    lambda: self._desk.apply(_gain_change(knob, value)),
                )

        return slider


def _gain_change(knob: Knob, value: float) -> Change:
    return change_of({"gains": knob.table(value)}, "gains")


def _uploaded(file: viser.UploadedFile) -> Law:
    """The one law of a file from the browser.

    Raises:
        InputError: it is not TOML or not one law; the message names the field.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / (Path(file.name).name or "law.toml")
        path.write_bytes(file.content)
        try:
            return load_law(path)
        except ValueError as error:
            raise InputError(str(error).replace(f"{folder}/", "")) from None
