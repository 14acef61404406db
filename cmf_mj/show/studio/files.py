"""Files of a page: the session as a scenario, its record, and scenarios to load."""

import tempfile
from pathlib import Path

import viser

from cmf_mj.facility.scenario.settings import read_scenario, scenario_toml
from cmf_mj.show.studio.desk import Desk


class FileControls:
    """Export and load."""

    def __init__(self, desk: Desk) -> None:
        """Add them to the container in force."""
        gui = desk.client.gui
        self._desk = desk
        gui.add_button(
            "export scenario", icon="download", hint="`cmf run` repeats this session bit for bit"
        ).on_click(lambda _: self._export())
        gui.add_button(
            "save record", icon="download", hint="what the session has kept, as Parquet"
        ).on_click(lambda _: self._save())
        upload = gui.add_upload_button("load scenario", icon="file-upload")

        @upload.on_upload
        def _(event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
            file = event.target.value
            try:
                text = file.content.decode("utf-8")
                desk.begin(read_scenario(text, file.name))
            except ValueError as error:
                desk.tell(error)

    def _export(self) -> None:
        text = scenario_toml(self._desk.live.scenario().result())
        self._desk.client.send_file_download(
            "session.toml", text.encode("utf-8"), save_immediately=True
        )

    def _save(self) -> None:
        record = self._desk.live.record().result()
        with tempfile.TemporaryDirectory() as folder:
            content = record.save(Path(folder) / "session.parquet").read_bytes()
        self._desk.client.send_file_download("session.parquet", content, save_immediately=True)
