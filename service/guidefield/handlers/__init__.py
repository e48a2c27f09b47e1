"""One function per request: domain calls in order, no network, no files."""
