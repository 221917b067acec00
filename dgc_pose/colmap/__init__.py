"""A COLMAP database and a reconstruction from the matches of a batch."""
