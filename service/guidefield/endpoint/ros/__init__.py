"""MoveIt's services and topics for ROS 2 nodes on rmw_zenoh, answered by the same engine; `node.py` offers them."""
