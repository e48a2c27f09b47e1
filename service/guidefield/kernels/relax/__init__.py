"""The objective of relaxing a path: a barrier on distances along it."""
