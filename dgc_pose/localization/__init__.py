"""The pose of a photograph in a model: visual localization from relative poses."""
