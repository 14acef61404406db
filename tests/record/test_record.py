"""Records: bit for bit through a file, immutable, complete, and whole or not there at all."""

import copy
import json
import pickle

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cmf_mj import Hexapod, Record, SingleLegs, load_law, signals, simulate
from cmf_mj.core.arrays import frozen
from cmf_mj.signals.single import Multisine, Step


@pytest.fixture(scope="module")
def run():
    command = signals.multisine("heave", 0.005, period=0.125, start=8.0, stop=40.0, seed=11)
    return simulate(Hexapod("rfd"), "velocity", command)


def small(**changes):
    values = {
        "time": np.arange(3.0),
        "channels": {"leg_position": np.arange(6.0).reshape(3, 2), "gimbal_error": np.ones(3)},
        "units": {"leg_position": "m", "gimbal_error": "m"},
        "metadata": {"sample_rate": 1.0},
    }
    return Record(**(values | changes))


# Through a file


def test_run_comes_back_bit_for_bit(run, tmp_path):
    again = Record.load(run.save(tmp_path / "run.parquet"))
    assert again == run and [*again.channels] == [*run.channels]


def test_odd_numbers_come_back_bit_for_bit(tmp_path):
    """Signed zero, subnormals, infinities and the payload of a NaN."""
    payload = np.array([0x7FF8000000000123], dtype=np.uint64).view(np.float64)[0]
    odd = np.array([-0.0, 5e-324, np.inf, -np.inf, payload, 1.0 / 3.0])
    first = small(
        time=np.arange(6.0),
        channels={"leg_position": np.column_stack([odd, odd[::-1]]), "gimbal_error": odd},
    )
    assert Record.load(first.save(tmp_path / "odd.parquet")) == first


def test_file_is_open_to_any_parquet_reader(run, tmp_path):
    table, again = pq.read_table(run.save(tmp_path / "run.parquet")), run.save(tmp_path / "two")
    assert again.read_bytes() == (tmp_path / "run.parquet").read_bytes()
    np.testing.assert_array_equal(table["leg_position_3"], run["leg_position"][:, 2])
    np.testing.assert_array_equal(table["time"], run.time)
    header = json.loads(table.schema.metadata[b"cmf_mj"])
    assert header["units"] == dict(run.units)


def test_names_that_share_a_column_do_not_lose_data(tmp_path):
    """`force` with two columns and a channel `force_1`: refused."""
    first = small(
        channels={"force": np.arange(6.0).reshape(3, 2), "force_1": np.full(3, 9.0)},
        units={"force": "N", "force_1": "N"},
    )
    with pytest.raises(ValueError, match="force_1: its column force_1 belongs to another channel"):
        first.save(tmp_path / "names.parquet")


# Whole or not at all


def fail_half_way(table, where, **_):
    where.write_bytes(b"PAR1 half a file")
    raise OSError("disk full")


def test_an_interrupted_write_leaves_what_was_there(tmp_path, monkeypatch):
    first, second, path = small(), small(metadata={"sample_rate": 2.0}), tmp_path / "run.parquet"
    for there in ([], [path]):
        with monkeypatch.context() as broken, pytest.raises(OSError, match="disk full"):
            broken.setattr(pq, "write_table", fail_half_way)
            second.save(path)
        assert list(tmp_path.iterdir()) == there
        if there:
            assert Record.load(path) == first
        first.save(path)
    assert Record.load(second.save(path)) == second
    assert list(tmp_path.iterdir()) == [path]


# Immutable


def test_no_depth_of_a_record_can_be_written_to():
    given = {"sample_rate": 1.0, "law": {"gains": [1.0, {"position": 2.0}]}}
    kept = small(metadata=given)
    for attempt in (
        lambda: kept.metadata["law"].update(gains=0),
        lambda: kept.metadata["law"]["gains"].append(0),
        lambda: kept.metadata["law"]["gains"][1].pop("position"),
        lambda: kept.metadata["law"]["gains"][1].__delitem__("position"),
    ):
        with pytest.raises(TypeError, match="it is read-only"):
            attempt()
    for values in (kept.time, *kept.channels.values()):
        with pytest.raises(ValueError, match="cannot set WRITEABLE"):
            values.flags.writeable = True
    given["law"]["gains"][1]["position"] = 3.0
    assert kept.metadata["law"]["gains"][1] == {"position": 2.0}
    assert json.loads(json.dumps(kept.metadata)) == kept.metadata


@pytest.mark.parametrize(
    "again", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))]
)
def test_records_copy_and_pickle_and_stay_immutable(run, again):
    other = again(run)
    assert other == run
    assert repr(other) == repr(run)
    with pytest.raises(TypeError, match="it is read-only"):
        other.metadata["law_parameters"]["title"] = "x"
    for values in (other.time, *other.channels.values()):
        assert not values.flags.writeable


def test_a_long_history_is_not_held_twice():
    """What is read-only and owns its values is taken over; views of it too; a part of it is not."""
    history = np.zeros((3, 2))
    history.setflags(write=False)
    kept = small(channels={"leg_position": history, "gimbal_error": history[:, 0]})
    assert np.shares_memory(kept["leg_position"], history)
    assert np.shares_memory(frozen(kept["leg_position"]), history)
    assert not np.shares_memory(kept["gimbal_error"], history)


def test_what_was_given_may_change_later():
    whole, units = np.zeros((3, 4)), {"leg_position": "m"}
    channels, metadata = {"leg_position": whole[:, :2]}, {"sample_rate": 1.0}
    kept = small(channels=channels, units=units, metadata=metadata)
    channels["other"], units["other"], metadata["other"], whole[:] = np.ones(3), "m", 1, 7.0
    assert set(kept.channels) == set(kept.units) == {"leg_position"}
    assert dict(kept.metadata) == {"sample_rate": 1.0}
    assert not kept["leg_position"].any()


def test_records_are_equal_where_all_their_content_is() -> None:
    """To the bit: -0 is not 0, and NaN is itself; a list, a whole number, single precision too."""
    numbers = {"gimbal_error": [1, 2, 3], "leg_position": np.float32([[0.1, np.nan]] * 3)}
    one, same = small(channels=numbers), small(channels=numbers)
    assert one == same and hash(one) == hash(same) and len({one, same}) == 1
    assert {values.dtype for values in one.channels.values()} == {np.dtype(float)}
    changes = {
        "time": np.arange(3.0) + 1.0,
        "channels": numbers | {"gimbal_error": np.ones((3, 1))},
        "units": {"leg_position": "rad", "gimbal_error": "m"},
        "metadata": {"sample_rate": 2.0},
    }
    assert all(one != small(**{"channels": numbers, name: v}) for name, v in changes.items())
    zeros = (small(time=np.zeros(3) * sign, channels={}, units={}) for sign in (1.0, -1.0))
    assert len({*zeros}) == 2 and one != "record"


def test_numbers_of_numpy_in_metadata_become_plain_ones(tmp_path) -> None:
    given = {"sample_rate": np.int64(1), "law": {"gain": np.float64(2.0), "all": np.arange(2)}}
    kept = small(metadata=given)
    assert kept.metadata == {"sample_rate": 1, "law": {"gain": 2.0, "all": [0, 1]}}
    assert kept.rate == 1.0 and type(kept.metadata["law"]["gain"]) is float
    assert Record.load(kept.save(tmp_path / "run.parquet")) == kept


# Complete


def test_metadata_say_how_to_repeat_the_run(run):
    assert run.metadata["law_parameters"] == load_law("velocity").model_dump()
    assert run.metadata["plant"] == "hexapod"
    assert run.metadata["hydraulic_parameters"]["leak_rate"]["unit"] == "1/s"
    assert run.metadata["mechanical_step"] == 1.0 / 2048.0
    assert run.metadata["command_delay"] == 1
    assert set(run.metadata["versions"]) == {"cmf-mj", "mujoco", "numpy", "numba"}


def test_metadata_repeat_the_run(run):
    assert run.signal_as(Multisine).described() == run.metadata["command"]
    with pytest.raises(ValueError, match="its command is a multisine; a step is needed"):
        run.signal_as(Step)
    assert "multisine, heave" in repr(run)
    described = dict(run.metadata["command"])
    kind = described.pop("kind")
    command = getattr(signals, kind)(**described, seed=run.metadata["seed"])
    plant = Hexapod(run.metadata["cab"], run.metadata["hydraulics"])
    again = simulate(plant, run.metadata["law"], command)
    assert again == run


def test_model_digest_tells_models_apart(run):
    digest = run.metadata["model_digest"]
    assert len(digest) == 64 and int(digest, 16) > 0
    assert digest == Hexapod("rfd").digest
    others = {Hexapod("gfd").digest, Hexapod("rfd", timestep=1.0 / 4096.0).digest}
    assert len(others | {digest, SingleLegs().digest}) == 4


def test_rate_and_time_agree(run):
    """Three periods of 0.125 s at 2048 Hz; every channel has a unit and all samples."""
    assert run.rate == 2048.0
    np.testing.assert_array_equal(run.time, np.arange(768) / 2048.0)
    assert set(run.units) == set(run.channels)
    assert all(len(values) == 768 for values in run.channels.values())


# Refusals


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"channels": {"gimbal_error": np.ones(4)}},
            r"gimbal_error: shape is \(4,\); allowed: \(3,",
        ),
        ({"channels": {"gimbal_error": np.ones((3, 0))}}, r"shape is \(3, 0\); allowed: \(3,"),
        ({"channels": {"gimbal_error": np.ones((3, 2, 2))}}, r"shape is \(3, 2, 2\); allowed"),
        ({"channels": {"gimbal_error": 3.0}}, r"gimbal_error: shape is \(\); allowed: \(3,"),
        ({"channels": {"gimbal_error": ["a"] * 3}}, "gimbal_error: holds <U1; allowed: real"),
        ({"channels": {"gimbal_error": 1j * np.ones(3)}}, "gimbal_error: holds complex128"),
        ({"time": np.ones((3, 1))}, r"time: shape is \(3, 1\); allowed: \(N,\)"),
        ({"units": {"leg_position": "m"}}, "every channel needs one unit; check gimbal_error"),
        (
            {"units": {"leg_position": "m", "gimbal_error": "m", "pressure": "Pa"}},
            "units: every channel needs one unit; check pressure",
        ),
    ],
)
def test_channels_that_do_not_match_are_named(changes, said):
    with pytest.raises(ValueError, match=said):
        small(**changes)


@pytest.mark.parametrize("name", ["law_state", "machine_parameters", "electronics", "command"])
def test_metadata_of_another_kind_are_named(name):
    """What reads them, such as a replay, failed inside; none at all is as good as null."""
    with pytest.raises(ValueError, match=f"metadata: {name}: 3 is refused; allowed: a table"):
        small(metadata={name: 3})
    kept = small(metadata={name: None})
    assert kept.metadata[name] is None and "3 samples" in repr(kept)


def test_files_of_another_kind_are_named(tmp_path):
    path = small().save(tmp_path / "run.parquet")
    for content in (path.read_bytes()[:-40], b"", b"not a parquet file at all"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="run.parquet: is not a readable Parquet file"):
            Record.load(path)
    pq.write_table(pa.table({"x": [1.0]}), path)
    with pytest.raises(ValueError, match="run.parquet: is Parquet, but carries no cmf_mj header"):
        Record.load(path)
