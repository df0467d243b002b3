"""Doubt in the inertial samples: how much further off they are than their white noise says.

White noise shows in the samples themselves. Vibration near a multiple of their rate, a range that
is exceeded, a sensor that sits askew do not: they show at the receiver, where what the samples add
up to is off to the same side at one fix as at the one before. So the correlation of consecutive
innovations raises the doubt, beyond what chance makes, and innovations smaller than expected lower
it: the further, the more the vehicle manoeuvres. Innovations that grow until they are refused are a
drift of the samples, a wild fix comes at once. A receiver that is refused again and again shows
it too, if its position moves as its velocity says.

Source: correlated innovations of a filter that trusts its model too much, Mehra 1970; a sum that
chance does not raise, Page 1954, "Continuous inspection schemes".
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.past import acceleration_noise
from cython.cimports.ekf_companion.core.memory.constants import NEVER
from cython.cimports.ekf_companion.core.memory.enums import AID_POSITION, AID_VELOCITY, N
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Fix, Motion, Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import slide
from cython.cimports.libc.math import exp, fabs, sqrt

LEAST_DOUBT = cython.declare(cython.double, 3e-5)
QUIET_DOUBT = cython.declare(cython.double, 0.0003)
"""The same while the vehicle does not manoeuvre."""
SUDDEN = cython.declare(cython.double, 4.0)
"""First refused NIS of a velocity, of its gate, from which on a fix is wild and no drift."""
USELESS = cython.declare(cython.double, 1000.0)
"""Doubt beyond which no estimate is good."""
RECOVERY = cython.declare(cython.double, 10e9)
"""Time after it for which none is called good: the attitude is to be found again, ns."""
REOPENED = cython.declare(cython.double, 4.0)
"""Variance of a bias that may be new, of that at the start: what a shock did to it is worse."""
LARGEST_DOUBT = cython.declare(cython.double, 1e4)
MEMORY = cython.declare(cython.double, 60e9)
"""Time constant with which the worst doubt is forgotten, ns: vibration comes back."""
LARGEST_MEMORY = cython.declare(cython.double, 300.0)
"""Largest doubt that is remembered."""
REMEMBERED = cython.declare(cython.double, 0.1)
"""Share of the worst doubt that is kept."""
GAIN = cython.declare(cython.double, 0.4)
"""Change of the logarithm of the doubt for a correlation of one."""
CHANCE = cython.declare(cython.double, 0.3)
"""Correlation of two innovations that is taken for chance while there is no doubt."""
CHANCE_DOUBT = cython.declare(cython.double, 0.02)
"""Doubt at which half of that is."""
SMALLNESS = cython.declare(cython.double, 0.3)
"""Weight of innovations that are smaller than expected, beside their correlation."""
POWER_MEMORY = cython.declare(cython.double, 30.0)
"""Fixes over which the mean NIS is taken that a correlation is a share of."""
LEAST_POWER = cython.declare(cython.double, 0.01)
EXCESS = cython.declare(cython.double, 1.0)
"""Weight of innovations beyond what the receiver states: either of the two may be worse."""
FAIR_EXCESS = cython.declare(cython.double, 1.5)
"""Mean square of these, of its expected value, that is no excess."""
LARGEST_EXCESS = cython.declare(cython.double, 9.0)
LARGEST_TERM = cython.declare(cython.double, 3.0)
"""Largest whitened innovation that counts, sigmas."""
OLD = cython.declare(cython.double, 3e9)
"""Time after which the innovation before says nothing of this one, ns."""
LARGEST_FAULT = cython.declare(cython.double, 15.0)
"""Largest error of an acceleration, by a wrong attitude or a fault, m/s^2: a receiver that gains
speed faster than that against the samples is wrong itself."""
LARGEST_STEP = cython.declare(cython.double, 2.0)
"""m/s, beside it."""
SHARED_DOUBT = cython.declare(cython.double, 0.3)
"""Doubt at which the receiver's variance has grown by half of what it may."""
SHOWN_SIGMAS = cython.declare(cython.double, 2.0)
"""Way in sigmas of a fix that shows whether the position moves as the velocity says."""
EXPECTED = cython.declare(cython.double, 9.0)
"""A refused innovation raises the doubt until its square is this times its new variance."""
LEAST_NOISE = cython.declare(cython.double, 1e-8)
"""Variance of the white noise of the best gyro that flies, rad^2/s."""
LEAST_FORCE_NOISE = cython.declare(cython.double, 4e-6)
"""Likewise of its accelerometer, m^2/s^3."""
USUAL_DOUBT = cython.declare(cython.double, 0.03)
"""Doubt at which biases walk as configured."""
LEAST_WALK = cython.declare(cython.double, 0.007)
QUIET_WALK = cython.declare(cython.double, 0.03)
"""The same while the vehicle does not manoeuvre."""
QUIET = cython.declare(cython.double, 0.1)
"""Mean square of the change of acceleration within a second, an axis, that is half a manoeuvre,
(m/s^2)^2."""
LARGEST_WALK = cython.declare(cython.double, 4.0)
LARGEST_GYRO_WALK = cython.declare(cython.double, 9.0)
"""Largest variance of the gyro's walk, of the configured one: 0.14 deg/s in a minute."""
MARGIN = cython.declare(cython.double, 1.5)
"""How much larger than the second differences show the variance of the noise may be."""
SCALE_VAR = cython.declare(cython.double, 2e-8)
"""Variance of the errors of scale and mounting of a calibrated sensor, over one second."""
DOUBTED_SCALE_VAR = cython.declare(cython.double, 1e-4)
"""The same of one that is doubted."""
HIDDEN_SCALE_VAR = cython.declare(cython.double, 2.5e-5)
"""The same of one that has not moved so far: half a percent, as data sheets have it."""
USUAL_RATE = cython.declare(cython.double, 2.0)
"""Rate up to which calibration and the usual flight show a gyro's scale, rad/s."""
USUAL_FORCE = cython.declare(cython.double, 9.8)
"""Likewise the acceleration, m/s^2: that of gravity."""
SIMILAR = cython.declare(cython.double, 4.0)
"""Square of a motion, of the largest flown, up to which that shows how good the samples are."""
SHOWING = cython.declare(cython.double, 10.0)
"""Time constant with which a motion shows it, s."""


def restart(x: State) -> None:
    """Begin anew with the configured noise: what raised the doubt has been found."""
    x.doubt = 1.0
    x.worst_doubt = 0.0
    x.innovation_power = 1.0
    x.innovation_t = NEVER


def chance(x: State) -> float:
    """Return the correlation of two innovations that is taken for chance.

    Without it the doubt wanders, and is in the mean ten times what there is to doubt. Where it
    counts already, and where nothing moves that would lower it again, none is.
    """
    return CHANCE * CHANCE_DOUBT / (CHANCE_DOUBT + x.doubt) * (1.0 - quiet_share(x))


def quiet_share(x: State) -> float:
    """Return how little the vehicle manoeuvres, 0 to 1.

    While its acceleration stays the same, tilt, biases and the receiver's slow errors cannot be
    told apart, and innovations that are small do not show that the samples are good.
    """
    square = x.gain.change - 2.0 * acceleration_noise(x)
    return QUIET / (QUIET + square) if square > 0.0 else 1.0


def walk_share(x: State) -> float:
    """Return the share of the configured random walks of the biases that counts.

    A bias that changes with vibration or temperature shows as any other doubt.
    """
    share = x.doubt / USUAL_DOUBT
    least = LEAST_WALK + (QUIET_WALK - LEAST_WALK) * quiet_share(x)
    share = share if share > least else least
    return share if share < LARGEST_WALK else LARGEST_WALK


def gyro_walk_share(x: State, share: float) -> float:
    """Return what becomes of that share for the gyro's biases, which may be seen to drift."""
    share *= x.walk.drift
    return share if share < LARGEST_GYRO_WALK else LARGEST_GYRO_WALK


def write_noise(x: State, k: Parameters, m: Motion, dt: float) -> None:
    """Write the variance that rate and force add over dt (s) into ``m.q``, an axis each."""
    rate2 = 0.0
    accel2 = 0.0
    for j in range(3):
        m.q[j] = k.gyro_noise * k.gyro_noise * dt
        m.q[j + 3] = k.accel_noise * k.accel_noise * dt
    if k.learn_noise == 0.0:
        return
    for j in range(3):
        rate2 += m.rate[j] * m.rate[j]
        accel2 += x.accel_n[j] * x.accel_n[j]
    rate_var = rate2 * scale_var(x, 0, rate2, USUAL_RATE * USUAL_RATE, dt)
    force_var = accel2 * scale_var(x, 1, accel2, USUAL_FORCE * USUAL_FORCE, dt)
    for j in range(3):
        q = MARGIN * x.noise[j]
        q = (q if q > LEAST_NOISE else LEAST_NOISE) + rate_var
        m.q[j] = x.doubt * m.q[j] + (q + x.unmeasured[j]) * dt
        q = MARGIN * x.noise[j + 3]
        q = (q if q > LEAST_FORCE_NOISE else LEAST_FORCE_NOISE) + force_var
        m.q[j + 3] = x.doubt * m.q[j + 3] + (q + x.unmeasured[j + 3]) * dt


def scale_var(x: State, sensor: int, square: float, usual: float, dt: float) -> float:
    """Return the variance of the errors of scale and mounting, relative, over one second.

    Beyond what is usual, they show only in motion that is as large: until the vehicle has moved so
    for some seconds, its rates (sensor 0) and accelerations (1) are doubted.
    """
    variance = SCALE_VAR + DOUBTED_SCALE_VAR * (x.doubt if x.doubt < 1.0 else 1.0)
    if square <= usual:
        return variance
    known = SIMILAR * x.shown[sensor]
    hidden = HIDDEN_SCALE_VAR * (1.0 - (known if known > usual else usual) / square)
    x.shown[sensor] += dt / (dt + SHOWING) * (square - x.shown[sensor])
    return variance if variance > hidden else hidden


def learn_doubt(
    x: State, k: Parameters, fix: Fix, o: Observation, nis: float, is_denied: bool
) -> None:
    """Learn from the innovation of the receiver's velocity, just judged."""
    correlation = 0.0
    smallness = 0.0 if is_denied else nis / o.rows - 1.0
    excess = 0.0
    size = 0.0
    for r in range(o.rows):
        own = fix.stated_var[AID_VELOCITY] + o.uneven[r]
        for j in range(N):
            own += o.H[r][j] * o.PHt[r][j]
        excess += o.z[r] * o.z[r] / (o.rows * own)
        y = o.y[r]
        y = y if y < LARGEST_TERM else LARGEST_TERM
        y = y if y > -LARGEST_TERM else -LARGEST_TERM
        correlation += y * x.last_innovation[r]
        size += y * y
        x.last_innovation[r] = y
    if o.rows < 3:
        x.last_innovation[2] = 0.0
    x.correlation = 0.0
    has_last = cython.declare(cython.bint, is_next(x))
    seen = nis / o.rows if nis < o.rows and not is_denied else 1.0
    x.innovation_power += (seen - x.innovation_power) / POWER_MEMORY
    if x.innovation_power < LEAST_POWER:
        x.innovation_power = LEAST_POWER
    if has_last:
        # of innovations that are all too small the correlation says as much; but what raises the
        # doubt beyond the configured noise must be larger than that explains
        power = x.doubt * x.doubt
        power = power if power > x.innovation_power else x.innovation_power
        x.correlation = correlation / (sqrt(o.rows) * (power if power < 1.0 else 1.0))
        x.worst_doubt *= exp((x.innovation_t - x.t) / MEMORY)
    x.innovation_t = x.t
    if is_denied or not nis <= k.gate[o.rows - 1]:
        if x.run[AID_VELOCITY].n == 0.0:
            ratio = nis / k.gate[o.rows - 1]
            is_led_up_to = cython.declare(
                cython.bint, has_last and not is_denied and ratio < SUDDEN and x.t - x.gap_t > OLD
            )
            x.is_gradual = 1.0 if is_led_up_to and correlation > 0.5 * size else 0.0
        if x.is_gradual == 0.0:  # who is wrong is not known yet
            return
    pull = x.correlation - chance(x)
    if smallness < 0.0:
        pull += SMALLNESS * smallness
    if excess > FAIR_EXCESS:
        excess = excess if excess < LARGEST_EXCESS else LARGEST_EXCESS
        pull += EXCESS * (excess - FAIR_EXCESS)
    is_dragged = cython.declare(cython.bint, x.refused_t[AID_POSITION] > x.used_t[AID_POSITION])
    if pull > 0.0 and (is_dragged or is_receivers_own(x, fix)):
        return
    x.doubt *= exp(GAIN * pull)
    if pull > 0.0:
        remember_doubt(x)
    bound_doubt(x)


def is_next(x: State) -> bool:
    """Return whether the innovation of the velocity before is recent."""
    return x.t - x.innovation_t < OLD


def remember_doubt(x: State) -> None:
    """Remember a doubt that has just risen, if it is the worst."""
    if x.doubt > x.worst_doubt:
        x.worst_doubt = x.doubt if x.doubt < LARGEST_MEMORY else LARGEST_MEMORY


def bound_doubt(x: State) -> None:
    """Keep the doubt within its bounds.

    Beyond use no attitude is good for a while. An error that grew until velocities were refused,
    and no gap, is that of an accelerometer whose bias may be a new one.
    """
    least = REMEMBERED * (x.worst_doubt - 1.0)
    floor = LEAST_DOUBT + (QUIET_DOUBT - LEAST_DOUBT) * quiet_share(x)
    if least < floor:
        least = floor
    if not x.doubt > least:
        x.doubt = least
    if x.doubt > LARGEST_DOUBT:
        x.doubt = LARGEST_DOUBT
    if x.doubt <= USELESS:
        return
    is_drift = cython.declare(
        cython.bint, x.is_gradual != 0.0 and x.refused_t[AID_VELOCITY] > x.used_t[AID_VELOCITY]
    )
    if x.t >= x.proven_t and is_drift and x.t - x.gap_t > RECOVERY:
        x.has_new_bias = 1.0
    x.proven_t = x.t + RECOVERY


def new_bias_share(x: State) -> float:
    """Return the variance that the accelerometer's biases gain once, of that at the start."""
    share = REOPENED * x.has_new_bias
    x.has_new_bias = 0.0
    return share


def receiver_share(x: State) -> float:
    """Return by how much the least sigma of the receiver's velocity grows, 1 to 2.

    Innovations to the same side may come of the receiver's own slow error as well.
    """
    return sqrt(1.0 + 3.0 * x.doubt / (x.doubt + SHARED_DOUBT))


def doubt_refusal(x: State, k: Parameters, fix: Fix, o: Observation) -> None:
    """Doubt the inertial side for a velocity that goes on being refused, if the position proves it.

    The receiver's position must have moved with that velocity, and so far that its noise cannot
    have made it.
    """
    largest = 0.0
    is_shown = cython.declare(cython.bint, False)
    for r in range(o.rows):
        if x.refused_t[AID_VELOCITY] == x.t:
            x.refused_way[r] = 0.0
        x.refused_way[r] += o.z[r] * x.fix_dt
        way = fabs(x.refused_way[r])
        if way > SHOWN_SIGMAS * fix.std[0 if r < 2 else 1] and fabs(x.split[r]) < 0.5 * way:
            is_shown = True
        if o.z[r] * o.z[r] > largest:
            largest = o.z[r] * o.z[r]
    since = (x.t - x.used_t[AID_VELOCITY]) * 1e-9
    most = LARGEST_FAULT * since + LARGEST_STEP
    if not is_shown or largest > most * most:
        return
    needed = 1.0
    if x.fix_dt > 0.0:
        needed = largest / (EXPECTED * k.accel_noise * k.accel_noise * x.fix_dt)
    if x.doubt < needed:
        x.doubt = needed
        remember_doubt(x)
    bound_doubt(x)


def is_receivers_own(x: State, fix: Fix) -> bool:
    """Return whether a disagreement is the receiver's, whatever the filter is in doubt of."""
    return slide.contradicts_itself(x, fix) or x.is_force_denied != 0.0
