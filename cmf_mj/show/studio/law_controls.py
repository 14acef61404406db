"""Controls of the law: shipped ones, one from a file, and a slider for each of its gains."""

import viser

from cmf_mj.control.law import Law, law_names, load_law
from cmf_mj.facility.scenario.settings import change_of
from cmf_mj.show.studio.desk import Desk, by_hand, picked, read_upload
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
        self._law = gui.add_dropdown("law", law_names("all"), initial_value="velocity")
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
            file = event.target.value
            try:
                law = read_upload(file.name, file.content, load_law)
            except ValueError as error:
                desk.tell(error)
                return
            option = f"{law.name} (file)"
            self._files[option] = law
            picked(self._law, option)
            self._choose(option)

    def sync(self, name: str, law: Law) -> None:
        """Show a law with its gains that did not come from these controls."""
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
            self._sliders += [self._slider(knob) for knob in knobs(law)]

    def _slider(self, knob: Knob) -> viser.GuiSliderHandle[float]:
        step = (knob.high - knob.low) / _STEPS
        slider = self._desk.client.gui.add_slider(
            knob.label, knob.low, knob.high, step, knob.value, hint=knob.hint
        )

        @slider.on_update
        def _(event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
            if by_hand(event):
                change = {"gains": knob.table(event.target.value)}
                key = ".".join(knob.path)
                self._desk.later(key, lambda: self._desk.apply(change_of(change, "gains")))

        return slider
