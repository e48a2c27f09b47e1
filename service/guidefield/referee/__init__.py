"""The referee: a second certifier, written from its page alone, with nothing of the first one's code."""
