"""Texts of orbits in every format beside tracking data, small and whole; numbers are made up."""

from __future__ import annotations

CPF = """\
H1 CPF  2  CSG 2018  6 13 10  6641 1 orekitSat
H2  1234567 705    99999 2018  6 12 23 59 42 2018  6 13 1 14 42   900 1 1  0 0 0 1
H5 0.0
00 a remark
H9
10 0 58281  85500.000000  0      -3442706.377      29234902.063       3170080.159
20 0 -300.5 100.0 -2900.0
10 0 58282      0.000000  0      -3443218.148      29401194.353        489466.784
20 0 -300.5 100.0 -2900.0
10 0 58282    900.000000  0      -3443218.148      29401194.353       -489466.784
20 0 -300.5 100.0 -2900.0
99
"""
SP3 = """\
#dV2024  3  1  0  0  0.00000000       3 ORBIT IGS20 HLM  IGS
## 2303 432000.00000000   900.00000000 60370 0.0000000000000
+    2   G01L52  0  0  0  0  0  0  0  0  0  0  0  0  0  0  0
++         3  3  0  0  0  0  0  0  0  0  0  0  0  0  0  0  0
%c M  cc GPS ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc
%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc
%f  1.2500000  1.025000000  0.00000000000  0.000000000000000
%i    0    0    0    0      0      0      0      0         0
/* made
*  2024  3  1  0  0  0.00000000
PG01  15000.123456 -20000.654321   8000.000001    123.456789
VG01 -12000.000000   5000.000000  31000.000000      0.000000
PL52   7000.000000   6000.000000   8000.000000 999999.999999
VL52 -12000.000000   5000.000000  31000.000000      0.000000
*  2024  3  1  0 15  0.00000000
PG01  15100.123456 -20100.654321   8100.000001    123.456789                   P
VG01 -12000.000000   5000.000000  31000.000000      0.000000
PL52      0.000000      0.000000      0.000000 999999.999999
VL52      0.000000      0.000000      0.000000      0.000000
*  2024  3  1  0 30  0.00000000
PG01  15200.123456 -20200.654321   8200.000001    123.456789
VG01 -12000.000000   5000.000000  31000.000000      0.000000
PL52   7200.000000   6200.000000   8200.000000 999999.999999
VL52 -12000.000000   5000.000000  31000.000000      0.000000
EOF
"""
OPM = """\
CCSDS_OPM_VERS = 2.0
COMMENT made
CREATION_DATE = 2024-03-01T00:00:00
ORIGINATOR = HERE
OBJECT_NAME = SAT
OBJECT_ID = 2024-001A
CENTER_NAME = EARTH
REF_FRAME = EME2000
TIME_SYSTEM = UTC
EPOCH = 2024-03-01T12:00:00.000
X = 6503.514000 [km]
Y = 1239.647000 [km]
Z = -717.490000 [km]
X_DOT = -0.873160 [km/s]
Y_DOT = 8.740420 [km/s]
Z_DOT = -4.191076 [km/s]
MASS = 3000.0 [kg]
COV_REF_FRAME = RTN
CX_X = 3.3e-04 [km**2]
CY_X = 4.6e-05
CY_Y = 6.7e-04
CZ_X = -3.0e-05
CZ_Y = -4.2e-05
CZ_Z = 2.3e-04
CX_DOT_X = -3.3e-08 [km**2/s]
CX_DOT_Y = -4.6e-08
CX_DOT_Z = 3.0e-08
CX_DOT_X_DOT = 4.2e-09 [km**2/s**2]
CY_DOT_X = -2.2e-08
CY_DOT_Y = -2.8e-08
CY_DOT_Z = 1.7e-08
CY_DOT_X_DOT = 2.6e-10
CY_DOT_Y_DOT = 1.7e-09
CZ_DOT_X = -3.0e-08
CZ_DOT_Y = -4.9e-08
CZ_DOT_Z = 3.5e-08
CZ_DOT_X_DOT = 1.8e-10
CZ_DOT_Y_DOT = 1.0e-10
CZ_DOT_Z_DOT = 6.2e-09
MAN_EPOCH_IGNITION = 2024-03-02T00:00:00
MAN_DURATION = 132.60
"""
OMM = {
    "OBJECT_NAME": "VANGUARD 1",
    "OBJECT_ID": "1958-002B",
    "CENTER_NAME": "EARTH",
    "REF_FRAME": "TEME",
    "TIME_SYSTEM": "UTC",
    "MEAN_ELEMENT_THEORY": "SGP4",
    "EPOCH": "2000-06-27T18:50:19.733568",
    "MEAN_MOTION": "10.82419157",
    "ECCENTRICITY": "0.1859667",
    "INCLINATION": "34.2682",
    "RA_OF_ASC_NODE": "348.7242",
    "ARG_OF_PERICENTER": "331.7664",
    "MEAN_ANOMALY": "19.3264",
    "EPHEMERIS_TYPE": "0",
    "CLASSIFICATION_TYPE": "U",
    "NORAD_CAT_ID": "5",
    "ELEMENT_SET_NO": "475",
    "REV_AT_EPOCH": "41366",
    "BSTAR": "0.000028098",
    "MEAN_MOTION_DOT": "0.00000023",
    "MEAN_MOTION_DDOT": "0",
}
"""Of `tests/data/files/test_element_sets.py`, whose epoch is day 179.78495062 of 2000."""


def omm(notation: str, fields: dict[str, str] = OMM) -> str:
    """A mean-elements message in one of four notations."""
    rows = list(fields.items())
    if notation == "kvn":
        return "CCSDS_OMM_VERS = 2.0\n" + "".join(f"{key} = {value}\n" for key, value in rows)
    if notation == "csv":
        plain = [pair for pair in rows if pair[0] not in list(OMM)[2:6]]
        return "\n".join(",".join(pair[k] for pair in plain) for k in (0, 1)) + "\n"
    if notation == "json":
        return "[{" + ",\n".join(f'"{key}": "{value}"' for key, value in rows) + "}]\n"
    inner = ["\n".join(f"<{k}>{v}</{k}>" for k, v in part) for part in (rows[:6], rows[6:13], rows[13:])]
    data = f"<data><meanElements>{inner[1]}</meanElements><tleParameters>{inner[2]}</tleParameters></data>"
    body = f"<body><segment><metadata>{inner[0]}</metadata>{data}</segment></body>"
    return f'<ndm><omm id="CCSDS_OMM_VERS" version="2.0"><header/>{body}</omm></ndm>\n'
