"""Worker processes behind a bounded queue."""
