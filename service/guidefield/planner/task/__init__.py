"""What is to be planned, what the planner tells meanwhile, and why a plan is refused."""
