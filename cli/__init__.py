"""The command line of dgc-pose."""
