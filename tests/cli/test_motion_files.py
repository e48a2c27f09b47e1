"""Motions in CSV files as people write them."""

from __future__ import annotations

from pathlib import Path

import pytest

from guidefield.cli.certifying import read_fields
from guidefield.errors import GuidefieldError

HEADS = ("time,j0,j1", " time, j0 , j1", 'time, "j0", "j1"', "time,position: j0, position:j1 ")


@pytest.mark.parametrize("head", HEADS)
def test_blanks_in_a_head_are_no_part_of_names(head: str, tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    file.write_text(f"{head}\n0, 0.0, 1.0\n1, 0.5, 1.5\n", encoding="utf-8")
    fields = read_fields(file)
    assert fields["position_names"] == ["j0", "j1"]
    assert fields["trajectory"] == {"times": [0.0, 1.0], "positions": [[0.0, 1.0], [0.5, 1.5]]}


def test_what_is_no_number_is_told_with_its_column(tmp_path: Path) -> None:
    semicolons = "column 'time;j0' has '0;0', which is no number; columns"
    for text, told in (("time;j0\n0;0\n", semicolons), ("j0,\n0,\n", "column '' has ''")):
        (tmp_path / "motion.csv").write_text(text, encoding="utf-8")
        with pytest.raises(GuidefieldError, match=told):
            read_fields(tmp_path / "motion.csv")
