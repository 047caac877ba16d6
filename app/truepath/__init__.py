"""Truepath: the service, and the client of other programs.

Rooms form a pipeline; each imports only the rooms before it: numerics → kinematics →
motion → files → measurement → alignment → estimation → planning → discovery → results →
compensation → answers → catalogue → machines → jobs → users, operation, service → main
→ cli. The Run file separates measurement from analysis: measurement closes it, analysis
opens it. Drivers and simulators are separate packages, found as plug-ins.
"""
