"""The service on Zenoh."""
