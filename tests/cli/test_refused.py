"""Lines that are refused: in one line, before any work, with nothing written."""

import shlex
from pathlib import Path

import pytest
from shared import cmf

from cmf_mj.cli.common import progress_bar
from cmf_mj.core.errors import InputError

REFUSED = {
    "compare --laws fast": "'fast'",
    "compare --dofs up": "'up'",
    "compare --cab bus": "'bus'",
    "compare --dofs ,": "names nothing; allowed: one name at least",
    "compare --plants boat": "'boat'",
    "compare --hydraulics missing.toml": "missing.toml",
    "compare --jobs 0": "jobs",
    "compare --jobs two": "jobs: 'two' is refused: input should be a valid integer",
    "compare --laws velocity,velocity": "laws: velocity, velocity must differ in name",
    "compare --amplitude '0 in'": "amplitude",
    "compare --amplitude 'nan in'": "amplitude: 'nan in' is not a finite number and a unit",
    "compare --amplitude 1": "amplitude: '1' has no unit",
    "compare --amplitude '1 deg'": "amplitude: unit 'deg' is refused for heave; allowed: in, m",
    "fly loop": "cmf: flight: 'loop' is not one of",
    "fly gusts --laws none": "law: 'none'",
    "fly gusts --washout none": "'none'",
    "flight loop --file x.csv": "flight: 'loop' is not one of",
    "flight turn --from telex": "form: 'telex' is not one of",
    "learn gusts --trials 0": "trials: '0' is refused",
    "learn loop": "flight: 'loop' is not one of",
    "learn gusts --law none": "law: 'none'",
    "cue missing.csv": "missing.csv",
    "cue gusts --washout best": "'best'",
    "cue gusts --cab bus": "'bus'",
    "cue gusts --rate 0": "rate",
    "list hydraulics water": "'water'",
    "list laws report": "set: 'report' is of no use to laws; allowed: none",
    "list hydraulics --machine simon": "'simon'",
    "machine new cmf": "is a shipped machine",
    "modes --cabs none": "'none'",
    "linearize --pose 1,2": "pose: '1,2' is refused; allowed: six finite numbers",
    "linearize --pose a,0,0,0,0,0": "allowed: six finite numbers",
    "linearize --pose nan,0,0,0,0,0": "allowed: six finite numbers",
    "linearize --pose 0,0,inf,0,0,0": "allowed: six finite numbers",
    "linearize --hydraulics lossy": "overlap: ",
    "linearize --dofs leg_9": "dof: 'leg_9' is not one of leg_1, leg_2",
    "linearize --dofs twist": "twist",
    "linearize --pose 0,0,-60,0,0,0": "pose: puts leg",
    "measure missing.csv": "missing.csv",
    "measure notes.txt": "notes.txt: cannot be read",
    "measure a.csv --estimator h3": "estimator: 'h3' is not one of h1",
    "measure a.csv --dof up": "dof: 'up' is not one of surge",
    "failure fire": "event: 'fire' is not one of pump_lost",
    "failure overload --size much": "size: 'much' is not a finite number and a unit",
    "failure overload --size 'nan lbf'": "size: 'nan lbf' is not a finite number",
    "failure overload --size '3 in'": "unit 'in' is not one of lbf, N",
    "failure all --size '1 in^2'": "size, valve: are for one event",
    "failure pump_lost --leg 2": "leg: 2 is not allowed",
    "failure pump_lost --jobs 0": "jobs: '0' is refused",
    "identify none.csv --orders 4,3": "orders: '4,3' is refused",
    "identify none.csv": "none.csv",
    "certify velocity velocity": "laws: velocity, velocity must differ in name",
    "study all": "study: 'all' is not one of",
    "report --figures 9-9": "figures: '9-9' is not one of 2-12, 2-13",
    "report --tables 9-9": "tables: '9-9' is not one of 2-4, 2-6",
    "report --jobs 0": "jobs: '0' is refused",
    "report ledger 999": "number: 999 is not one of 1 to",
    "report linear --laws fast": "'fast'",
    "serve --port 70000": "port: 70000 is refused",
    "serve --host-port 70000": "host_port: '70000' is refused",
    "serve --lockstep": "lockstep: is nothing to the protocol cmf",
    "serve --protocol moog --begin settled": "begin: 'settled' is nothing to the protocol moog",
    "serve --protocol moog --begin engaged": "begin: 'engaged' is nothing to the protocol moog",
    "serve --bind everywhere": "bind: 'everywhere' is not an IPv4 address",
    "serve --port 0 --seconds -1": "seconds: -1.0 is refused; allowed: above 0",
}


@pytest.mark.parametrize("line", REFUSED)
def test_a_line_is_refused_in_one_line_and_writes_nothing(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    output = " ".join(cmf(*shlex.split(line), code=2).split())
    assert REFUSED[line] in output and "Traceback" not in output
    assert not list(tmp_path.rglob("*"))


def test_an_error_leaves_no_bar_of_progress(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar() as update:
        update(1, 2)
    assert "running" in capsys.readouterr().err
    with pytest.raises(InputError), progress_bar() as update:
        update(1, 2)
        raise InputError("law: is refused")
    assert capsys.readouterr().err.strip() == ""
