"""A new swing, line by line on standard output: its angle every 0.25 s from 1.25 rad on."""

import math
import random
import sys

draw = random.Random(2)
angle, rate = 1.25, 0.0
sys.stdout.write("time,angle\n")
for k in range(1, 41):
    for _ in range(250):
        rate -= 0.0005 * 9.81 * math.sin(angle)
        angle += 0.001 * rate
        rate -= 0.0005 * 9.81 * math.sin(angle)
    sys.stdout.write(f"{0.25 * k},{angle + draw.gauss(0, 0.01):.4f}\n")
