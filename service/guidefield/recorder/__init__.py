"""The recorder: the one room that knows Rerun; `guidefield.recorder.recorder` is its door."""
