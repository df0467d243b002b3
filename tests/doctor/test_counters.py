"""The rate that a message was last asked for."""

from ekf_companion.doctor.counters import MessageCounter


def asked(*dialogue):
    counter = MessageCounter()
    for rate, answer in dialogue:
        counter.request(rate)
        counter.receive_answer(answer)
    return counter.asked


def test_what_is_asked_after_a_refusal_is_no_change_of_mind():
    assert asked((250.0, "denied"), (200.0, "accepted"), (200.0, "accepted")) == 250.0


def test_after_a_reload_the_last_rate_counts():
    assert asked((250.0, "accepted"), (100.0, "accepted")) == 100.0
    assert asked((250.0, "denied"), (200.0, "accepted"), (100.0, "accepted")) == 100.0
    assert asked((100.0, "accepted"), (250.0, "denied"), (200.0, "accepted")) == 250.0
    assert asked((250.0, "accepted"), (0.0, "accepted")) == 0.0
