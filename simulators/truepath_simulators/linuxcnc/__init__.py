"""LinuxCNC without a screen and closed off: a real CNC for test rigs.

Its planner, interpreter and limits are its own; only the drives are ideal. It needs
Debian's linuxcnc-uspace, Linux and root (namespaces).

    files       the INI and HAL files of a machine
    rig         one LinuxCNC from start to end, its ports and its positions
    gateway     the register map over Modbus TCP before it, beside it in the namespaces
    inside      what runs beside it in the namespaces, by the system's Python
"""
