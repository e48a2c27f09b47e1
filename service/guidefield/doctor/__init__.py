"""What is wrong with this machine for guidefield, and what to do about it."""
