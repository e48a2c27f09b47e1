"""Kernels of streams: a commit's piece, stop and limits (`phases`), schedules among obstacles (`dodge`)."""
