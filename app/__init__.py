"""Truepath: the service. Rooms form a pipeline; each imports only the rooms before it.

numerics → kinematics → planning → measurement → alignment → estimation → reporting →
discovery → jobs → web → api → main → cli. A Run on disk is the waist: measuring ends by
closing a Run, science begins by opening one.
"""
