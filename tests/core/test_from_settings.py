from dataclasses import astuple

import numpy as np
import pytest
from scipy.stats import chi2

from ekf_companion.core.memory.aid import DECLARED
from ekf_companion.core.memory.enums import Aid
from ekf_companion.core.memory.overlay import as_parameters
from ekf_companion.core.settings.faults import FAULTS
from ekf_companion.core.settings.from_settings import chi_square_quantile, delays_ns, parameters
from ekf_companion.core.settings.settings import HABITS, FilterSettings, GnssSettings
from ekf_companion.nav.measurements import Kind


@pytest.mark.parametrize("dof", [1, 2, 3])
@pytest.mark.parametrize("probability", [0.5, 0.9, 0.99, 0.9999, 0.999999])
def test_gates_are_chi_square_quantiles(dof, probability):
    assert chi_square_quantile(probability, dof) == pytest.approx(
        chi2.ppf(probability, dof), rel=1e-9
    )


def test_every_parameter_is_given():
    k = as_parameters(parameters(FilterSettings(weigh_faults="off"), "unknown"))
    given = {
        name: np.ravel(getattr(k, name)) for name, _ in k._fields_ if name not in ("aid", "fault")
    }
    may_be_zero = {"gnss_delay", "lag", "lever_arm_b", "heading", "keeps_bias", "weighs_faults"}
    may_be_zero |= {"vehicle", "lag_std"}
    may_be_unknown = ["unset_delay", "white_share"]
    assert [name for name, one in given.items() if np.isnan(one).any()] == may_be_unknown
    assert {name for name, one in given.items() if (one == 0.0).any()} == may_be_zero
    for declared in DECLARED:
        one = k.aid[Aid[declared.name.upper()]]
        assert min(one.std, one.error, one.errors, one.parts) > 0.0
        assert one.use == getattr(FilterSettings(), declared.name).use
        for i, error in enumerate(declared.slow_errors.values()):
            assert (one.walk[i] > 0.0) == (error.walk is not None)
            assert (one.speed_walk[i] > 0.0) == (error.speed_walk is not None)
    for kind, prior in FAULTS.items():
        of = k.fault[kind]
        numbers = (of.source, of.rows, of.std, of.tail, of.rate, of.every, of.shows)
        assert numbers == astuple(prior)


def test_auto_follows_the_family_unless_told_otherwise():
    auto = FilterSettings()
    told = FilterSettings(gnss=GnssSettings(delay=0.2))
    assert delays_ns(auto, "ardupilot")[Kind.GNSS] == round(HABITS["ardupilot"].gnss_delay * 1e9)
    assert delays_ns(auto, "px4", gnss_delay=0.11)[Kind.GNSS] == 110_000_000
    assert delays_ns(told, "px4", gnss_delay=0.11)[Kind.GNSS] == 200_000_000
