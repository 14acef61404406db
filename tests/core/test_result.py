"""Results: what is declared once stands in frame, files and table alike."""

import csv
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cmf_mj import InputError
from cmf_mj.core.result import Field, Result, Table, column, groups, where
from cmf_mj.core.tables import read_table


class Load(NamedTuple):
    """The largest load of a leg."""

    leg: int
    load: float | None  # [N]


RESULT = Result(
    [Load(1, 12345.6), Load(2, float("nan")), Load(3, None)],
    (
        *(Field("", "of", of=lambda row: f"leg {row.leg}"), Field("leg", printed=False)),
        Field("load_n", "load [kN]", ".1f", "kN", of="load"),
    ),
    "loads",
    provenance={"law": "velocity"},
)


def test_a_result_is_a_sequence_of_its_rows() -> None:
    assert len(RESULT) == 3
    assert RESULT[0] == Load(1, 12345.6)
    assert [row.leg for row in RESULT[1:]] == [2, 3]
    assert list(RESULT) == RESULT.rows


def test_the_frame_has_what_is_named_and_the_table_what_is_printed() -> None:
    """SI in the frame, the field's unit in print: 12345.6 N are 12.3 kN."""
    assert RESULT.frame.column_names == ["leg", "load_n"]
    assert RESULT.frame["load_n"][0].as_py() == 12345.6
    assert RESULT.table.cells == [["leg 1", "12.3"], ["leg 2", "-"], ["leg 3", "-"]]
    assert str(RESULT).splitlines()[2] == "| leg 1 | 12.3 |"
    assert RESULT.to_pandas()["load_n"].sum() == 12345.6


def test_files_hold_the_frame_with_titles_and_provenance(tmp_path: Path) -> None:
    paths = {end: RESULT.save(tmp_path / f"r.{end}") for end in ("md", "csv", "parquet", "json")}
    assert paths["md"].read_text() == f"# loads\n\n{RESULT.table.markdown()}"
    noted = Table("", ("leg",), [("1",)], "of one leg").save(tmp_path / "noted.md")
    assert noted.read_text() == "| leg |\n| --- |\n| 1 |\n\nof one leg\n"
    with paths["csv"].open(newline="") as file:
        assert list(csv.reader(file)) == [["leg", "load_n"], ["1", "12345.6"], ["2", ""], ["3", ""]]
    read = read_table(paths["parquet"])
    assert column(read, "load_n")[0] == 12345.6
    about = json.loads(pq.read_schema(paths["parquet"]).metadata[b"cmf_mj_result"])
    assert about["provenance"] == {"law": "velocity"}
    assert about["fields"]["load_n"] == {"title": "load [kN]", "unit": "kN"}
    content = json.loads(paths["json"].read_text())
    assert content["rows"] == [
        {"leg": 1, "load_n": 12345.6},
        *({"leg": n, "load_n": None} for n in (2, 3)),
    ]
    assert {name: content[name] for name in about} == about
    with pytest.raises(InputError, match=r"r\.xlsx: must end in \.md, \.csv, \.parquet or \.json"):
        RESULT.save(tmp_path / "r.xlsx")


def test_groups_keep_the_order_of_their_first_row_and_every_row() -> None:
    generator = np.random.default_rng(3)
    laws = generator.choice([*"dcab"], 5000).tolist()
    draws = generator.integers(0, 99, 5000).tolist()
    table = pa.table({"law": laws, "draw": draws, "place": range(5000)})
    found = {values: rows["place"].to_pylist() for values, rows in groups(table, "law", "draw")}
    by_hand: dict[tuple[str, int], list[int]] = {}
    for place, key in enumerate(zip(laws, draws, strict=True)):
        by_hand.setdefault(key, []).append(place)
    assert found == by_hand
    assert list(found) == list(by_hand)
    assert where(table, law="a", draw=2)["place"].to_pylist() == by_hand["a", 2]
