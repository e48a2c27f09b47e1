"""The vocabulary of the wire and of files: requests, replies, scenes, and their encoding."""
