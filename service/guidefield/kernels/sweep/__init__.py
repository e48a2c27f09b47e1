"""Whether capsules about links stay apart from everything along a motion."""
