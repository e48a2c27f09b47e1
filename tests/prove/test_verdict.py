"""Two verdicts about one motion: it is refused where the first refuses it, and certified as far as both certify."""

from __future__ import annotations

from guidefield.prove.verdict import Reason, Verdict, first_refused

FREE = Verdict(Reason.FREE, 3)
EARLY = Verdict(Reason.CONTACT, 5, 2, 0.5, (2, 0.4))
LATE = Verdict(Reason.UNDECIDED, 7, 2, 0.6, (1, 0.9))


def test_the_first_refusal_is_told() -> None:
    for one, other in ((EARLY, LATE), (LATE, EARLY)):
        both = first_refused(one, other)
        assert (both.reason, both.piece, both.parameter, both.evaluations) == (Reason.CONTACT, 2, 0.5, 12)


def test_what_the_later_one_does_not_certify_is_not_certified() -> None:
    assert first_refused(EARLY, LATE).free_until == (1, 0.9)
    assert first_refused(LATE, EARLY).free_until == (1, 0.9)


def test_one_that_is_free_takes_nothing_away() -> None:
    both = first_refused(FREE, EARLY)
    assert (both.reason, both.free_until, both.evaluations) == (Reason.CONTACT, (2, 0.4), 8)
    assert first_refused(FREE, FREE).free
    assert first_refused(FREE, FREE).free_until is None
