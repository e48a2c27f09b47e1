"""The service on Zenoh: `service.py` starts and ends it, `endpoint.py` sorts and answers queries; `ros` for ROS 2."""
