"""The bank of fault hypotheses: what the estimate would be off by, if a fault had begun.

``setup.py`` makes ``bank.pxd`` from it. What lies before ``T`` outlives a step, as far as there are
instances; so a snapshot copies that and no more (``packing`` says how it is kept). What lies behind
it is written before it is read.
"""

from typing import Annotated

from ekf_companion.core.memory.declare import Count, Real, Structs, Vector, doubles, struct
from ekf_companion.core.memory.enums import AIDS, FAULTS, SOURCES, N

INSTANCES = 500
"""Most that are kept; the least probable goes where there is no room. No power of two: rows that
lie so far apart share no place in a cache."""
FOUND = 32
"""Faults that are kept to be told."""
DELAYS = 26
"""Delays of the fixes that are compared."""
COMPONENTS = 4
"""Most of a fault."""
MOVING = 15
"""Error states that a transition mixes: attitude, velocity, position, both biases."""


@struct
class Instance:
    """One fault that began at one time, and how the state would be off by it."""

    kind: Count
    """:class:`~.enums.Fault`."""
    level: Count
    """It stands for 2^level onsets; -1: of a heading, that it is off from the first one on."""
    t0: Real
    """Onset, ns."""
    log_prior: Real
    """Logarithm of its prior probability: its rate times the time in which it may have begun, its
    own and of those that went into it."""
    evidence: Real
    """Log-likelihood of what came since, beside that of no fault."""
    earlier: Real
    """The same at the begin of the window of the inertial noise."""
    p: Real
    """Its posterior probability."""
    is_wide: Real
    """It is of the tenth that is larger by orders of magnitude. Of what has no shape: it has been
    declared."""
    recent: Real
    """Mean NIS a row of the last readings that it shows in."""
    readings: Real
    """How many there were."""
    rows: Count
    """Components of b."""
    tau: Real
    """Time constant of what settles; the delay about which another is linear, s. Of the end of a
    heading's fault: 1, it was declared; 0, it was there from the first one on."""
    reference: Real
    """Height at the onset, m, down."""
    b: Annotated[Vector, COMPONENTS]
    """The fault's mean, in its unit."""
    M: Annotated[Vector, COMPONENTS, COMPONENTS]
    """Its covariance."""


@struct
class Found:
    """A fault that was beyond doubt."""

    kind: Count
    """:class:`~.enums.Fault`."""
    onset: Real
    """ns."""
    until: Real
    """When it was so last, ns."""
    b: Annotated[Vector, 3]
    """Its mean then, in its unit."""
    var: Annotated[Vector, 3]
    """Variance of each component then."""
    evidence: Real
    """Log-likelihood then, beside that of no fault."""


@struct
class Trial:
    """What an instance learns from one reading, before that is taken."""

    D: Annotated[Vector, 3, 3]
    """What a fault adds to the reading itself, by row and component."""
    T: Annotated[Vector, 3, COMPONENTS]
    """All that it adds, whitened."""
    b: Annotated[Vector, COMPONENTS]
    M: Annotated[Vector, COMPONENTS, COMPONENTS]
    gain: Annotated[Vector, COMPONENTS]
    """M T'."""
    nis: Annotated[Vector, 2]
    """Of the level rows, of the vertical ones."""
    spread: Real
    """How many times larger the rows' determinant is by what is not known of the fault."""


@struct
class Bank:
    """All instances; how the state has moved since their columns followed it; who repeats."""

    resets: Real
    """Of the state and one more, when they were counted last; 0: the bank has not begun."""
    redrawn: Annotated[Vector, N]
    """Likewise of each error state."""
    fix_t: Real
    """Of the last fix by which instances began, ns."""
    begun_t: Annotated[Vector, AIDS]
    """When the last ones of each spacing began, ns."""
    proven_t: Real
    """When the start was proven by fixes, ns: what is off before may be our own."""
    has_begun: Real
    """Instances have begun before: what a receiver does at its first fix is over."""
    weighed_t: Annotated[Vector, AIDS]
    """When a reading of each aid was weighed last, ns."""
    Phi: Annotated[Vector, MOVING, MOVING]
    """Transition since the columns followed."""
    faded: Annotated[Vector, 3]
    """Share that is left of the slow errors of heading, position and velocity since then."""
    sum: Annotated[Vector, AIDS, 3]
    """Of the whitened innovations of each aid in the block that is being filled."""
    count: Annotated[Vector, AIDS]
    block_t: Annotated[Vector, AIDS]
    """Begin of that block, ns."""
    common: Annotated[Vector, AIDS]
    """How many readings in a row say the same, as learnt: one, if they are white."""
    read_t: Annotated[Vector, AIDS]
    """When each aid was read last, ns."""
    read_dt: Real
    """How long ago the reading before the one that is judged was, s."""
    last: Annotated[Vector, AIDS, 3]
    """Innovation of each row of an aid at its reading before."""
    last_var: Annotated[Vector, AIDS, 3]
    """Its variance."""
    led: Annotated[Vector, AIDS, 3]
    """How far each row of an aid is led away from ours, if it follows a wandering velocity."""
    led_var: Annotated[Vector, AIDS, 3]
    """Its variance."""
    judged: Count
    """Aid of the observation that was judged last."""
    erratic_var: Annotated[Vector, AIDS, 2]
    """Mean square of the errors of an aid that is wrong in no shape, as learnt: level, vertical."""
    nothing: Real
    """Posterior probability that nothing is wrong."""
    astray: Real
    """The same of our yaw, that it is off by any angle."""
    since: Annotated[Vector, SOURCES]
    """Since when a source is beyond doubt, ns."""
    declared: Annotated[Vector, FAULTS]
    """How often each kind was."""
    held: Annotated[Vector, 4]
    """Offset by declared faults, taken off the readings: position n e d, barometer, m."""
    restless: Annotated[Vector, 3]
    """Square of what was declared of a source that had just failed: position n e d, m^2."""
    delay_cost: Annotated[Vector, DELAYS]
    """What the last velocities of fixes cost, by how late they are taken to be."""
    delay_rows: Real
    """Of how many rows that is."""
    let_go: Annotated[Vector, 2]
    """Square of what a reset took over of a held offset of position and height, m^2; it fades."""
    natural: Annotated[Vector, 2]
    """Variance of the slow error of position and height where nothing was declared, m^2."""
    drift: Annotated[Vector, 4]
    """Rate at which a declared slide goes on: position n e d, barometer, m/s."""
    drift_var: Annotated[Vector, 4]
    drift_t: Annotated[Vector, 4]
    """Since when, ns."""
    driven_t: Annotated[Vector, 4]
    """Until when it was driven, ns."""
    fade: Annotated[Vector, 4]
    """Rate at which what is held fades, 1/s."""
    fade_var: Annotated[Vector, 4]
    """Variance of its logarithm."""
    faded_from: Annotated[Vector, 4]
    """What was held when that was declared, m."""
    heading_off: Real
    """What was declared of the heading in use, and is held in its slow error, rad."""
    heading_off_var: Real
    """Its variance then."""
    azimuth: Real
    """Of which heading that is, :class:`~.enums.Azimuth`."""
    field_slope: Annotated[Vector, 2]
    """What a field in n does to the last azimuth, rad/gauss."""
    taken: Annotated[Vector, FAULTS, 3]
    """What is taken off the readings: of declared faults that no error state holds."""
    taken_var: Annotated[Vector, FAULTS, 3]
    taken_t: Annotated[Vector, FAULTS]
    """Onset of each, ns."""
    taken_tau: Annotated[Vector, FAULTS]
    taken_reference: Annotated[Vector, FAULTS]
    window_t: Real
    """Begin of the window of the inertial noise, ns."""
    lam: Annotated[Vector, 6]
    """Sum over the window of T' y: accelerometer, gyro."""
    Lam: Annotated[Vector, 6]
    """Sum of T' T."""
    hold_t: Real
    """Until when nothing is declared: the inertial noise has just grown, ns."""
    failed_t: Annotated[Vector, SOURCES]
    """When each source was declared last, ns."""
    log_share: Real
    """Logarithm of the share of the configured inertial noise."""
    information: Real
    """Of that, from the last minute."""
    means: Annotated[Vector, 3, 9]
    """What those add that show in all rows, in the level, in the vertical ones."""
    mean: Annotated[Vector, 9]
    """What the mixture adds to attitude, velocity, position."""
    spread: Annotated[Vector, 9, 9]
    """What it adds to their covariance."""
    found: Annotated[Structs, Found, FOUND]
    """What was beyond doubt for long enough; the newest of many takes the place of the last."""
    finds: Count
    n: Count
    pairs: Count
    """Instances of two components or more: they stand first."""
    triples: Count
    """Of three or more: they stand before those."""
    fours: Count
    """Of four: they stand before those."""
    carried: Count
    """Error states whose columns were saved with a bank."""
    has_moved: Count
    """The columns have not followed yet."""
    is_observed: Count
    """T is of the observation that is being judged."""
    instance: Annotated[Structs, Instance, INSTANCES]
    U: Annotated[Vector, COMPONENTS, N, INSTANCES]
    """The state's error by each component: the right estimate is x + U b."""
    T: Annotated[Vector, COMPONENTS, 3, INSTANCES]
    """What a component adds to each row of the innovation."""
    kept: Count
    """Place of the instance that stays while others are dropped; -1: none does."""
    rival: Count
    """Place of another one that does."""
    work: Annotated[Vector, N]
    before: Annotated[Vector, 4]
    """Rates of declared slides before the last was declared, m/s; slow errors before a fix, m."""
    was_held: Annotated[Vector, 4]
    """What was held then, m."""
    rows: Annotated[Vector, 2]
    """Level and vertical rows of the observation that is being judged."""
    group: Annotated[Vector, 3]
    """Of each row: 0, it is level; 1, it is vertical."""
    wrong: Annotated[Vector, 2]
    """Probability that the source of the level, and of the vertical rows is wrong."""
    erratic: Annotated[Vector, 2]
    """The part of it that it is so in no shape."""
    square: Annotated[Vector, 2]
    """That times the mean square of the errors then."""
    ahead: Annotated[Vector, COMPONENTS, 9]
    """Columns of an instance as of now."""
    trial: Trial


BANK = doubles(Bank)
"""Of numbers of 8 bytes."""
