"""The recorder: the one room that imports Rerun; entries are `recorder.py`, `stream_recorder.py` and `live_view.py`."""
