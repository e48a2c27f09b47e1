"""Kernels of streams: limits of a commit (`judge`), its piece and stop (`way`), schedules among obstacles (`dodge`)."""
