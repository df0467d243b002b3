"""Where everything lies in the flat blocks: the filter's state, its parameters, one event.

``layout.pxd`` says the same to the compiler; a test holds the two together. Times in a block are
nanoseconds since the timeline's epoch, whole numbers, exact in a double for 104 days.
"""

# An event: time of validity, kind, then the values of nav.measurements
ROW_T = 0
ROW_KIND = 1
ROW_V = 2
ROW = 15

# Error states: attitude (in n), velocity, position, gyro bias, accel bias, baro offset, GNSS delay,
# heading offset
E_ATT = 0
E_VEL = 3
E_POS = 6
E_BG = 9
E_BA = 12
E_BARO = 15
E_DELAY = 16
E_HEADING = 17
N = 18

# What the filter is doing
MODE_INIT = 0
MODE_LEVEL = 1
MODE_ATTITUDE = 2
MODE_NAVIGATE = 3

# Aids: the order of their accounts in the block
AID_POS = 0
AID_HGT = 1
AID_VEL = 2
AID_YAW = 3
AID_BARO = 4
AIDS = 5

# Why a fix went unused: the order of the counters
WHY_FUSED = 0
WHY_GATED = 1
WHY_UNALIGNED = 2
WHY_UNUSED = 3
WHYS = 4

# The state block
X_T = 0
X_MODE = 1
X_Q = 2
X_VEL = 6
X_POS = 9
X_BG = 12
X_BA = 15
X_BARO = 18
X_DELAY = 19
X_GYRO = 20
X_ACCEL = 23
X_DT = 26
X_LAT0 = 27
X_LON0 = 28
X_ALT0 = 29
X_SCALE_N = 30
X_SCALE_E = 31
X_HAS_ORIGIN = 32
X_DECLINATION = 33
X_HAS_YAW = 34
X_HAS_BARO = 35
X_RESETS = 36
X_SAMPLES = 37
X_NEEDS_RESET = 38
X_ACC_N = 39
X_ARMED = 42
X_LANDED = 43
X_T_FIX = 44
X_FIX_DT = 45
X_T_HEADING = 46
X_T_MAG = 49
X_T_RAW_FIX = 50
X_T_FAKE = 51
X_AT_REST = 52
X_GAPS = 53
X_RESET_REASON = 54
X_T_USED = 55
X_RATIO = 60
X_COUNT = 65
X_HEADING_SOURCE = 85
X_NOISE_G = 88
X_NOISE_A = 91
X_PREV_G = 94
X_PREV_A = 97
X_T_REFUSED = 100
X_LEVEL = 106
X_WHITE = 141
X_SLOW_POS = 144
X_SLOW_HGT = 145
X_INCLINATION = 146
X_FIELD = 147
X_HEADING = 148
X_HEADING_STD = 149
X_COV = 150
BLOCK = 474

# What levelling remembers, from X_LEVEL: sums over a window, the motion since a first fix, and a
# reference: a direction of the body and its azimuth (NaN: that of the magnetic field)
L_T0 = 0
L_N = 1
L_GYRO = 2
L_ACCEL = 5
L_GYRO2 = 8
L_ACCEL2 = 11
L_Q = 14
L_U = 18
L_HAS_FIX = 21
L_FIX_T = 22
L_FIX_V = 23
L_FIX_STD = 26
L_HAS_REF = 27
L_REF_T = 28
L_REF_V = 29
L_REF_STD = 32
L_REF_TARGET = 33
L_START = 34
L_SIZE = 35

# Parameters
K_GYRO_NOISE = 0
K_ACCEL_NOISE = 1
K_GYRO_WALK = 2
K_ACCEL_WALK = 3
K_GYRO_BIAS = 4
K_ACCEL_BIAS = 5
K_LEARN_NOISE = 6
K_MEAN_SAMPLES = 7
K_LEVER = 8
K_DELAY_STD = 11
K_POS_FLOOR = 12
K_HGT_FLOOR = 13
K_VEL_FLOOR = 14
K_VEL_DEFAULT = 15
K_USE_VEL = 16
K_USE_DERIVED = 17
K_HEADING = 18
K_MAG_STD = 19
K_MAG_NOISE = 20
K_HEADING_FLOOR = 21
K_BARO_STD = 22
K_BARO_WALK = 23
K_USE_BARO = 24
K_GATE1 = 25
K_GATE2 = 26
K_GATE3 = 27
K_TIMEOUT_POS = 28
K_TIMEOUT_VEL = 29
K_TIMEOUT_HGT = 30
K_TIMEOUT_YAW = 31
K_ALIGN_TIME = 32
K_LAG = 33
K_GAP = 34
K_GAP_RESET = 35
K_LIMIT_POS = 36
K_REST_GYRO = 37
K_REST_ACCEL = 38
K_GRAVITY = 39
K_FIELD_STRENGTH = 40
K_FIELD_DIP = 41
K_HEADING_TIME = 42
PARAMETERS = 43

# Headings that the filter may use (K_HEADING)
HEADING_AUTO = 0
HEADING_GNSS = 1
HEADING_MAG = 2
HEADING_AUTOPILOT = 3

# Why the filter was reset last (X_RESET_REASON)
RESET_NONE = 0
RESET_POSITION = 1
RESET_VELOCITY = 2
RESET_HEIGHT = 3
RESET_YAW = 4
RESET_GAP = 5
RESET_CLOCK = 6
RESET_BOUNDS = 7
RESET_RESTART = 8

# Scratch numbers of one step: rows of H, P H', innovation, R, Cholesky factor, error state,
# direction cosines, velocity increment, two rows, S and S G / 2, noise
W_H = 0
W_C = 54
W_Z = 108
W_R = 111
W_L = 120
W_Y = 129
W_DX = 132
W_C_NB = 150
W_DV = 159
W_ROW = 162
W_ROW2 = 180
W_S9 = 198
W_Q = 216
SCRATCH = 222

# An estimate: nav.state.COLUMNS without the time
OUT_LLA = 0
OUT_POS = 3
OUT_VEL = 6
OUT_Q = 9
OUT_EULER = 13
OUT_BG = 16
OUT_BA = 19
OUT_SD = 22
OUT_STATUS = 31
OUT_RESETS = 32
OUT = 33
