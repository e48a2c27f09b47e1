"""Whether bodies touch at sixteen configurations, and along motions."""
