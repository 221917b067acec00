"""Training from photographs: pairs made on the fly, staged losses, runs that survive a kill."""
