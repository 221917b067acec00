"""What cameras are read from: a module for each format."""
