"""Files and arrays: inputs that are checked, outputs that appear whole."""
