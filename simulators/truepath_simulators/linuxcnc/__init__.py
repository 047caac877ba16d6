"""LinuxCNC without a screen, isolated: a real CNC for test rigs.

Planner, interpreter and limits are LinuxCNC's; only the drives are ideal. It needs
Debian's linuxcnc-uspace, Linux and root (namespaces).

    files       the INI and HAL files of a machine
    rig         one LinuxCNC from start to end, its ports and its positions
    gateway     the register map over Modbus TCP in front of it, in its namespaces
    inside      program in its namespaces, by the system's Python
"""
