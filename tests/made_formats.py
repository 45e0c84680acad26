"""Texts of every format of tracking data, small and whole, that tests share; numbers are made up."""

from __future__ import annotations

from pathlib import Path

from made_orbits import CPF, OPM, SP3, omm

CRD = """\
h1 CRD  1 2016  2 13 14
h2 YARL       7090  5 13 3
h3 lageos2     9207002 5986    22195 0 1
h4  1 2016  2 13 23 40  0 2016  2 14  0 20  0  0 0 0 0 1 0 2 0
c0 0  532.000 std la1 mcp ti1
c1 0 la1 Nd:Yag     532.00       5.00     100.00  150.0 15.00    1
60  std 4 1
40 85200.400564399999 0 std       -1       -1  -1.000   105320.0    -17.0   27.0  -1.000  -1.000   -1.0 2 2 0
20 85260.000  983.70 301.40  24. 0
11 85260.000562600000     0.040000000000 std 2  120.0     94   57.0   0.183  -0.536      -1.0  15.67 0
11 85380.000567399997     0.039500000000 std 2  120.0     39   65.0   0.083  -0.301      -1.0   6.50 0
11 86300.000563799999     0.038000000000 std 2  120.0      9   82.0  -0.646  -0.963      -1.0   1.50 0
11   160.000567200001     0.038100000000 std 2  120.0     12   44.0  -0.349  -1.525      -1.0   2.00 0
20   660.000  981.70 300.40  34. 0
11 87060.000565399996     0.038600000000 std 2  120.0     16   54.0  -0.189  -0.571      -1.0   2.67 0
50 std   57.5   0.002   2.862   -1.0 0
h8
H1 CRD 1 2016 2 14 3
H2 STL3       7825 90 01  4
H3 lageos2     9207002 5986   022195 0 1
H4  1 2016 02 14 01 00 00 2016 02 14 02 06 43  0 0 0 0 1 0 2 0
C0 0 532.10 IDAA IDAB IDAJ IDAV
11 3600.5 0.041 IDAA 2 120.0 3 27.0 -0.035 -1.500 -1.0 0.50 0
11 4000.25 0.0405 IDAA 2 120.0 3 27.0 -0.035 -1.500 -1.0 0.50 0
H8
H9
"""
CRD2 = """\
00 a remark before anything
H1 CRD 2 2007 3 20 14
H2 ZIMMERWALD 7810 68 1 7 EUROLAS
H3 LAGEOS1 7603901 1155 8820 0 1 1
H4 1 2006 12 30 7 35 34 2006 12 30 8 12 29 0 0 0 0 1 0 2 0
H5 1 06 123000 esa 8401
C0 0 846.000 std1
C0 0 423.000 std2
C5 0 swv Monitor 2.0 conpro 2.4
11 27334.1080890 0.051571851861 std1 2 120 36 154.0 na na na 0.0 0 0.0
20 27334.1080890 923.30 275.40 43 1
40 27334.1080890 0 std1 na na 0.000 113069.0 0.0 138.0 na na na 2 2 0 1 na
11 27343.5080895 0.051405458691 std2 2 120 28 79.0 na na na 0.0 0 0.0
11 28003.8080894 0.042252027043 std1 2 120 19 170.0 na na na 0.0 0 0.0
21 28003.8 3.1 45 none 20 na 3 10 300.12
20 28003.8080894 923.40 275.50 42 1
93 28004 mine
50 std1 165.0 na na na 0
H8
H9
"""
TABLE = """\
# made
2010-11-02T03:00:13.3851   RANGE       Uralla         38014.9488
2010-11-02T03:00:50.5716   AZ_EL       Kumsan           211.1446   43.4099
2010-11-02T03:02:39.3147   AZ_EL       Uralla           298.3727   30.5573
2010-11-02T03:03:56.5606   RANGE       Uralla         37949.1425
2010-11-02T03:04:51.5343   RANGE_RATE  Kumsan           -1.25
2010-11-02T03:06:23.7897   RA_DEC      Uralla           298.0329   -30.1641
"""
SIDECAR = """\
object: W3B
clock: UTC
event: receive
units: {RANGE: km, AZ_EL: deg}
deviations: {RANGE: 0.02, AZ_EL: 0.02}
"""
META = """\
TIME_SYSTEM = UTC
START_TIME = 2024-03-01T00:00:00
STOP_TIME = 2024-03-01T01:00:00
PARTICIPANT_1 = DSS-1
PARTICIPANT_2 = 2024-001A
MODE = SEQUENTIAL
PATH = 1,2,1
TIMETAG_REF = RECEIVE
INTEGRATION_INTERVAL = 10
INTEGRATION_REF = END
RANGE_MODULUS = 0
RANGE_UNITS = s
ANGLE_TYPE = AZEL
DATA_QUALITY = VALIDATED
"""
DATA = """\
RANGE = 2024-03-01T00:00:00.5 0.005
ANGLE_1 = 2024-03-01T00:00:00.5 359.5
ANGLE_2 = 2024-03-01T00:00:00.5 45
RANGE = 2024-061T00:00:10.5Z 0.0051
DOPPLER_INTEGRATED = 2024-03-01T00:00:10 -1.25
DOPPLER_INSTANTANEOUS = 2024-03-01T00:00:20 1.5
PRESSURE = 2024-03-01T00:00:00 1000
PRESSURE = 2024-03-01T00:00:20 1010
TEMPERATURE = 2024-03-01T00:00:00 280
RHUMIDITY = 2024-03-01T00:00:00 50
RECEIVE_FREQ_1 = 2024-03-01T00:00:00 1e9
"""


def kvn(meta: str = META, data: str = DATA) -> str:
    """A tracking data message of one segment, in keyword = value notation."""
    head = "CCSDS_TDM_VERS = 2.0\nCOMMENT made\nCREATION_DATE = 2024-03-01T00:00:00\nORIGINATOR = HERE\n"
    return f"{head}META_START\n{meta}META_STOP\nDATA_START\nCOMMENT all\n{data}DATA_STOP\n"


def xml(meta: str = META, data: str = DATA) -> str:
    """The same in XML."""
    pairs = [line.split(" = ") for line in meta.splitlines()]
    said = "\n".join(f"<{key}>{value}</{key}>" for key, value in pairs)
    cells = [line.replace(" = ", " ").split() for line in data.splitlines()]
    seen = "\n".join(f"<observation><EPOCH>{t}</EPOCH><{k}>{v}</{k}></observation>" for k, t, v in cells)
    head = "<header><COMMENT>made</COMMENT><CREATION_DATE>2024-03-01</CREATION_DATE></header>"
    body = f"<segment><metadata>\n{said}\n</metadata><data>\n{seen}\n</data></segment>"
    return f'<?xml version="1.0"?>\n<tdm id="CCSDS_TDM_VERS" version="2.0">{head}<body>{body}</body></tdm>\n'


SINEX = """\
%=SNX 2.01 JCT 20:119:43200 JCT 79:215:00000 20:119:43200 C 01338 2 X V
*-----------------------------------------------------------------------
+FILE/COMMENT
 anything
-FILE/COMMENT
+SOLUTION/EPOCHS
*Code PT SOLN T Data_start__ Data_end____ Mean_epoch__
 7090  A    1 C 83:011:58876 05:001:00000 99:007:13417
 7090  A    2 C 05:001:00001 30:000:00000 09:007:13417
-SOLUTION/EPOCHS
+SOLUTION/ESTIMATE
*INDEX TYPE__ CODE PT SOLN _REF_EPOCH__ UNIT S __ESTIMATED VALUE____ _STD_DEV___
     1 STAX   7090  A    1 10:001:00000 m    2 -.238900750000000E+07 0.51901E-03
     2 STAY   7090  A    1 10:001:00000 m    2 0.504332940000000E+07 0.30033E-03
     3 STAZ   7090  A    1 10:001:00000 m    2 -.307852420000000E+07 0.22901E-03
     4 VELX   7090  A    1 10:001:00000 m/y  2 -.468389138240797E-01 0.34434E-04
     5 VELY   7090  A    1 10:001:00000 m/y  2 0.839461295243685E-02 0.22507E-04
     6 VELZ   7090  A    1 10:001:00000 m/y  2 0.509471988578335E-01 0.25057E-04
     7 STAX   7090  A    2 10:001:00000 m    2 -.238900850000000E+07 0.51901E-03
     8 STAY   7090  A    2 10:001:00000 m    2 0.504333040000000E+07 0.30033E-03
     9 STAZ   7090  A    2 10:001:00000 m    2 -.307852520000000E+07 0.22901E-03
    10 VELX   7090  A    2 10:001:00000 m/y  2 -.468389138240797E-01 0.34434E-04
    11 VELY   7090  A    2 10:001:00000 m/y  2 0.839461295243685E-02 0.22507E-04
    12 VELZ   7090  A    2 10:001:00000 m/y  2 0.509471988578335E-01 0.25057E-04
    13 RBIAS  7090  A    1 10:001:00000 m    2 0.509471988578335E-01 0.25057E-04
-SOLUTION/ESTIMATE
+SITE/ECCENTRICITY
*SITE PT SOLN T DATA_START__ DATA_END____ UNE UP______ NORTH___ EAST____        CDP-SOD_
 7090  A    1 L 79:182:00000 14:079:86399 UNE   3.1850   0.0030   0.0110        70900501
 7090  A    1 L 14:080:00000 00:000:00000 UNE   3.1827-112.0064-565.4650        70900513
-SITE/ECCENTRICITY
%ENDSNX
"""
BULLETIN = """\
                                                                BULLETIN B 274
                                                                6 Decembre 2010
 1 - DAILY FINAL VALUES OF  x, y, UT1-UTC, dX, dY
 Angular unit is milliarcsecond (mas), time unit is millisecond (ms).
       DATE     MJD       x       y      UT1-UTC      dX     dY     x err    y err   UT1 err  X err  Y err
 Final values
2010  10   2   55471  234.008  363.573  -60.4401    0.326 -0.006    0.013    0.023    0.0867  0.113  0.284
2010  10   3   55472  234.032  361.012  -61.1022    0.334 -0.056    0.013    0.018    0.0824  0.106  0.266
 Preliminary extension
2010  10   4   55473  233.967  358.601  -62.1292    0.311 -0.135    0.014    0.017    0.0562  0.055  0.139
2010  10   5   55474  234.197  356.277  -63.4764    0.266 -0.152    0.014    0.017    0.0420  0.055  0.139
 2 - DAILY FINAL VALUES OF CELESTIAL POLE OFFSETS dPsi1980 & dEps1980
2010  10   2   55471   -73.969    -9.587     1.234     0.284
"""
FILES = {
    "crd1.npt": CRD,
    "crd2.np2": CRD2,
    "table.aer": TABLE,
    "kvn.tdm": kvn(),
    "xml.tdm": xml(),
    "stations.snx": SINEX,
    "bulletin.txt": BULLETIN,
    "cpf.csg": CPF,
    "orbits.sp3": SP3,
    "start.opm": OPM,
    **{f"{notation}.omm": omm(notation) for notation in ("xml", "kvn", "csv", "json")},
}
"""Each format by the name of a file."""
REAL = Path(__file__).parents[2] / "shared" / "real"
"""Real files, where the folder beside the checkout has them."""
