"""Plans for the model of a Model Context Protocol client: asked over the service's own door, answered in words."""
