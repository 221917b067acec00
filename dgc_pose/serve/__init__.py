"""A page on this machine that estimates poses: `dgc-pose serve`.

The server trusts no client: see `guard` for who may ask, `options` for how much may be sent, and
`worker` for how long anything may take.
"""
