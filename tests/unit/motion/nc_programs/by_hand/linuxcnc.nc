(PROGRAM BY_HAND)
(PATH CHECKSUM 0123456789AB)
g21 g17 g40 g49 g80 g90 g94 (lower case is the same)
G61.1
N1 G53 G1 X10 Y20.5 Z-30 C0 F6000 (ROW 1)
(MSG, record)
M0
G4 P1.5
N2 G53 G01 X100.25 (row 2)
G4 P.5
G61
N3 G53 G1 C90 F1800 (ROW 3)
N4 G1 G53 X0C0F300 (ROW 4)
M2
anything after the end is no part of the program
