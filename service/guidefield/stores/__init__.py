"""What outlives a request on disk: runs with their recordings, and scenes that clients stored."""
