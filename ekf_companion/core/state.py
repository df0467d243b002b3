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
# heading offset, slow error of the GNSS position (in n), hard iron (in b)
E_ATT = 0
E_VEL = 3
E_POS = 6
E_BG = 9
E_BA = 12
E_BARO = 15
E_DELAY = 16
E_HEADING = 17
E_SLOW = 18
E_IRON = 21
N = 24

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
AID_REST = 5
AIDS = 6

# What became of a measurement: the order of the counters
WHY_FUSED = 0
WHY_GATED = 1
WHY_UNALIGNED = 2
WHY_UNUSED = 3
WHY_SOFT = 4
WHY_SUSPECT = 5
WHY_DISTURBED = 6
WHYS = 7

# What a run of refused measurements remembers: number, first time, and the sums that a straight
# line through its innovations needs
C_COUNT = 0
C_T0 = 1
C_ST = 2
C_STT = 3
C_SZ = 4
C_STZ = 7
C_SZZ = 10
C_SIZE = 11

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
X_HEADING = 20
X_SLOW = 21
X_IRON = 24
X_GYRO = 27
X_ACCEL = 30
X_DT = 33
X_LAT0 = 34
X_LON0 = 35
X_ALT0 = 36
X_SCALE_N = 37
X_SCALE_E = 38
X_HAS_ORIGIN = 39
X_DECLINATION = 40
X_INCLINATION = 41
X_FIELD = 42
X_HAS_YAW = 43
X_HAS_BARO = 44
X_RESETS = 45
X_RESET_REASON = 46
X_T_RESET = 47
X_DELTA = 48
X_SAMPLES = 55
X_NEEDS_RESET = 56
X_ACC_N = 57
X_ARMED = 60
X_LANDED = 61
X_GROUND = 62
X_HAS_GROUND = 63
X_T_FIX = 64
X_FIX_DT = 65
X_LAST_FIX = 66
X_REPEATS = 69
X_T_HEADING = 70
X_T_MAG = 73
X_T_FIELD = 74
X_T_FIELD0 = 75
X_FIELD_SIZE = 76
X_T_RAW_FIX = 77
X_T_FAKE = 78
X_AT_REST = 79
X_REST_G = 80
X_REST_A = 81
X_GAPS = 82
X_T_RESTORED = 83
X_T_USED = 84
X_T_REFUSED = 90
X_RATIO = 96
X_NIS_SUM = 102
X_NIS_N = 108
X_COUNT = 114
X_HEADING_SOURCE = 156
X_HEADING_STD = 157
X_NOISE_G = 158
X_NOISE_A = 161
X_BLOCK_SUM = 164
X_BLOCK_N = 170
X_BLOCK_DT = 171
X_BLOCKS = 172
X_BLOCK1 = 173
X_BLOCK2 = 179
X_WHITE = 185
X_SLOW_POS = 188
X_SLOW_HGT = 189
X_LEAN = 190
X_RUN = 193
X_LEVEL = 226
X_LOGLIK = 263
X_BANK = 264
X_FRESH = 1029
X_COV = 1053
BLOCK = 1629

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
L_REF_NOISE = 33
L_REF_IRON = 34
L_REF_TARGET = 35
L_START = 36
L_SIZE = 37

# What the bank of yaw filters keeps, from X_BANK: its frame, what it has summed since the last
# fix, what it concludes, and what it has to say of the main filter
B_MODE = 0
B_Q = 1
B_BG = 5
B_BG_STD = 8
B_U = 9
B_G = 12
B_DT = 21
B_A = 22
B_WHITE = 24
B_REFUSED = 25
B_MEAN = 26
B_MOVED = 28
B_YAW = 29
B_STD = 30
B_TILT = 31
B_GOOD = 32
B_NIS = 33
B_T_FAIL = 34
B_REPAIRS = 35
B_T_REPAIR = 36
B_H = 37
B_SIZE = 765

# One hypothesis, from B_H + n H_SIZE: weight; state: velocity north and east, yaw of the bank's
# frame, its tilt about x and y, gyro bias, delay of the receiver; covariance of that
HYPOTHESES = 8
H_W = 0
H_X = 1
H_P = 10
H_N = 9
H_SIZE = 91

# What the bank is doing (B_MODE)
BANK_LEVELLING = 0
BANK_RUNNING = 1

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
K_SLOW_TIME = 18
K_WHITE_SHARE = 19
K_TIMING = 20
K_POS_WALK = 21
K_HEADING = 22
K_MAG_STD = 23
K_MAG_NOISE = 24
K_IRON_STD = 25
K_IRON_WALK = 26
K_HEADING_FLOOR = 27
K_HEADING_TIME = 28
K_FIELD_STRENGTH = 29
K_FIELD_DIP = 30
K_BARO_STD = 31
K_BARO_WALK = 32
K_USE_BARO = 33
K_GATE = 34
K_SOFT = 37
K_TIMEOUT_POS = 40
K_TIMEOUT_VEL = 41
K_TIMEOUT_HGT = 42
K_TIMEOUT_YAW = 43
K_ALIGN_TIME = 44
K_LAG = 45
K_GAP = 46
K_GAP_RESET = 47
K_LIMIT_POS = 48
K_REST_GYRO = 49
K_REST_ACCEL = 50
K_USE_REST = 51
K_GRAVITY = 52
K_KEEPS_BIAS = 53
PARAMETERS = 54

# Headings that the filter may use (K_HEADING)
HEADING_AUTO = 0
HEADING_GNSS = 1
HEADING_MAG = 2
HEADING_AUTOPILOT = 3

# What a long gap leaves to be done (X_NEEDS_RESET): nothing has been heard of position and
# velocity since; fixes have come again, but have not shown the attitude yet
NEEDS_NOTHING = 0
NEEDS_FIX = 1
NEEDS_TILT = 2

# Why the filter was reset last (X_RESET_REASON)
RESET_NONE = 0
RESET_POSITION = 1
RESET_VELOCITY = 2
RESET_HEIGHT = 3
RESET_YAW = 4
RESET_GAP = 5
RESET_CLOCK = 6
RESET_BOUNDS = 7
RESET_MOTION = 8
RESET_RESTART = 9

# Scratch numbers of one step: rows of H, P H', innovation, R, Cholesky factor, error state,
# direction cosines, velocity increment, two rows, S and S G / 2, noise; rate and force: the mean of
# the whole interval, of a part, and how fast they change; the fix that is being taken
W_H = 0
W_C = 72
W_Z = 144
W_R = 147
W_L = 156
W_Y = 165
W_DX = 168
W_C_NB = 192
W_DV = 201
W_ROW = 204
W_ROW2 = 228
W_S9 = 252
W_Q = 270
W_MEAN = 276
W_RATE = 282
W_FORCE = 285
W_RATE_SLOPE = 288
W_FORCE_SLOPE = 291
W_FIX = 294
SCRATCH = 306

# A tape (core/tape.py), if there is one, lies behind the scratch numbers: how many records it has,
# then these: how each follows from the one before, whether it ends a sample, block, transition
TAPE_COUNT = 306
TAPE = 307
T_LINK = 0
T_IS_SAMPLE = 1
T_BLOCK = 2
T_PHI = 1631
RECORD = 2207

# How a record follows from the one before
LINK_SAME = 0
LINK_MOVED = 1
LINK_FRESH = 2
LINK_CUT = 3

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

# What is told of it: ODOMETRY's numbers, in its order
TOLD_POS = 0
TOLD_Q = 3
TOLD_VEL = 7
TOLD_RATE = 10
TOLD_POSE = 13
TOLD_TWIST = 34
TOLD = 55
