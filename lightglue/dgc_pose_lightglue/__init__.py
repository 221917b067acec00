"""The graphs and weights of dgc-pose's matcher aliked-lightglue; dgc-pose has the code."""

FORMAT = 1  # of the files; dgc-pose refuses another one
