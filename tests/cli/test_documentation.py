"""`guidefield docs`: pages are rendered, and an unknown subject is told what may have been meant."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from guidefield.cli import app, documentation
from guidefield.errors import UnknownObject

FOLDER = Path(__file__).resolve().parents[2] / "service" / "docs"


def test_every_page_is_a_subject_that_begins_with_a_heading_and_a_sentence() -> None:
    assert set(documentation.list_subjects()) == {path.stem for path in FOLDER.glob("*.md")}
    for subject in documentation.list_subjects():
        text = documentation.read_page(subject)
        assert text.startswith("# ")
        sentence = documentation.first_sentence(text)
        assert sentence.endswith((".", ":"))
        assert 4 <= len(sentence.split()) <= 40


@pytest.mark.parametrize("subject", documentation.list_subjects())
def test_a_page_is_rendered(subject: str) -> None:
    done = CliRunner().invoke(app, ["docs", subject])
    assert done.exit_code == 0
    heading = documentation.read_page(subject).partition("\n")[0].removeprefix("# ")
    assert heading in done.output
    assert "```" not in done.output
    assert "\x1b" not in done.output


def test_an_unknown_subject_is_told_what_may_have_been_meant() -> None:
    with pytest.raises(
        UnknownObject, match=r"no page about 'certificat'; did you mean certificate or certify\?.* there are quickstart"
    ):
        documentation.read_page("certificat")
    with pytest.raises(UnknownObject, match="there are quickstart") as refused:
        documentation.read_page("../../../etc/passwd")
    assert "did you mean" not in refused.value.message
    done = CliRunner().invoke(app, ["docs", "wyre"])
    assert done.exit_code != 0
    assert "did you mean wire?" in str(done.exception)


def test_a_message_is_shown_with_what_each_field_may_be_and_means() -> None:
    done = CliRunner().invoke(app, ["docs", "PlanRequest"])
    assert done.exit_code == 0
    assert "min_clearance" in done.output
    assert "did you mean PlanReply" in str(CliRunner().invoke(app, ["docs", "PlanRepli"]).exception)
