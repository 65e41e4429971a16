"""The benchmark of a monitor of four tests: its files are the monitor and each of its tests alone."""

from benchmarks import banks


def test_each_test_of_the_monitor_stands_beside_it_alone():
    one, *alone = [banks.plant(tests).tests for tests in banks.models().values()]
    assert [test.name for test in one] == ["windows", "lags", "means", "observer"]
    assert tuple(test for tests in alone for test in tests) == one


def test_what_a_monitor_costs_is_said_beside_the_sum_of_its_tests():
    found = {test["name"]: {"seconds": 2.0} for test in banks.TESTS} | {"bank": {"seconds": 10.0}}
    assert banks.beside(found, "seconds") == 1.25
