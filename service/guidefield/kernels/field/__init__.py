"""The potential of charged surfaces and its derivatives, at points and on whole robots."""
