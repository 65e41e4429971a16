"""Numbers as people read them."""

from jaxbound.text.quantities import duration, percent, times


def test_numbers_read_well():
    assert [percent(x) for x in (0, 1e-9, 0.1234, 0.99999, 1)] == [
        "0 %",
        "<0.1 %",
        "12.3 %",
        ">99.9 %",
        "100 %",
    ]
    assert [times(x) for x in (1.0004, 2.149, 12345.6, 3e12)] == [
        "1.0004 times",
        "2.15 times",
        "12346 times",
        "3e+12 times",
    ]
    assert [duration(x) for x in (0.01, 90, 600, 9000, 10**6)] == [
        "0.01 s",
        "90 s",
        "10 min",
        "2.5 h",
        "11.6 d",
    ]
