"""ROS 2 nodes on rmw_zenoh ask the service as they ask MoveIt: MoveIt's services and topics, on the same engine."""
