"""Sixty swings of a pendulum, its angle read every 0.1 s for 8 s with an error of 0.01 rad."""

import csv
import math
import random

draw = random.Random(1)
with open("swings.csv", "w", newline="") as file:
    rows = csv.writer(file)
    rows.writerow(["id", "t [s]", "angle [rad]"])
    for swing in range(61):
        angle, rate = draw.uniform(0.3, 2.0), 0.0
        for k in range(81):
            rows.writerow([swing, round(0.1 * k, 1), round(angle + draw.gauss(0, 0.01), 5)])
            for _ in range(100):  # leapfrog steps of 1 ms
                rate -= 0.0005 * 9.81 * math.sin(angle)
                angle += 0.001 * rate
                rate -= 0.0005 * 9.81 * math.sin(angle)
