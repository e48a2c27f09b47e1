"""The recorder: the one room that imports Rerun.

Entries are `recorder.py`, `stream_recorder.py` and `live_view.py`, and for reading `stored.py`; the page to try
(cli/trying.py) takes colours, bodies and eyes from here.
"""
