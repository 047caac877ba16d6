"""Truepath: the service, and the client of other programs.

Rooms form a pipeline; each imports only the rooms before it:

numerics → kinematics → motion → files → measurement → alignment → estimation →
planning → discovery → results → compensation → answers → catalogue → machines →
jobs → users, operation, service → main → cli. A Run on disk separates measurement
from analysis: the one closes it, the other opens it. Drivers and simulators are
packages of their own, found as plug-ins.
"""
