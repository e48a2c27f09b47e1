from __future__ import annotations

import json

from hypothesis import given, settings, strategies as st

from guidefield.recorder.documents import LONGEST_LIST, LONGEST_TEXT, readable

SHORT = st.recursive(
    st.none() | st.booleans() | st.integers(-999, 999) | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(st.text(max_size=8), inner, max_size=6),
    max_leaves=20,
)


@settings(deadline=None, max_examples=30)
@given(SHORT)
def test_what_is_short_is_plain_json(value):
    assert json.loads(readable(value)) == value


def test_long_lists_and_texts_say_how_much_they_leave_out():
    rows = [[float(i), 0.0] for i in range(100)]
    shown = readable(rows)
    assert f"… {100 - LONGEST_LIST // 2 - 1} more …" in shown
    assert "[0, 0]" in shown
    assert "[99, 0]" in shown
    assert "[50, 0]" not in shown
    assert "… 700 more characters" in readable("x" * (LONGEST_TEXT + 700))
    assert "… 700 more characters" in readable({"float32": bytes(3 * (LONGEST_TEXT + 700) // 4)})
