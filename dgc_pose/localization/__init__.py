"""The pose of a photograph in a model: visual localization by relative poses."""
