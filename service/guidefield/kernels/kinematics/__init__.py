"""Where joints, links and tips are at configurations, how they move, and configurations that bring a tip to a place."""
