"""dgc-pose in the shapes that other tools expect of a matcher."""
