"""The clearance of a robot at one configuration as a barrier: its value, gradient and Hessian."""
