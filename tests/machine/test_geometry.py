"""Degrees of freedom by name."""

import doctest

import pytest

import cmf_mj
from cmf_mj.machine import geometry as dof
from cmf_mj.machine.geometry import DOFS


def test_three_lengths_then_three_angles():
    assert [dof.dof_unit(name) for name in DOFS] == ["in"] * 3 + ["deg"] * 3
    assert [dof.dof_unit(i) for i in range(6)] == [dof.dof_unit(name) for name in DOFS]
    assert [dof.dof_index(name) for name in DOFS] == list(range(6))


def test_examples_run():
    failed, attempted = doctest.testmod(dof, extraglobs={"cmf_mj": cmf_mj})
    assert attempted and not failed


def test_unknown_degree_of_freedom_lists_the_six():
    with pytest.raises(ValueError, match="dof: 'up' is not one of surge, sway, heave, roll"):
        dof.by_kind("up", 1.0, 2.0)
