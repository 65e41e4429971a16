"""What holds for every family of windows: a Monitor says what detect says, and certificates stand without
jaxbound.
"""

import json

import check_certificate
import numpy as np

import jaxbound as jb


def monitor_agrees(relations, u, y, res):
    """Insist that a Monitor says the same as a Result with exact margins, bit for bit; in blocks as long as
    those of detect, whose kernels are compiled.

    Short blocks are those of test_monitor and test_whole_numbers.
    """
    mon = jb.Monitor(relations)
    mon._test.short = mon._test.block
    _, said = mon.run(mon.init(), u, y)
    np.testing.assert_array_equal(said.status, res.status)
    np.testing.assert_array_equal(said.margin, res.margin)


def certificates_hold(res):
    """Insist that the first FAULT and the first CONSISTENT window of a Result have certificates that
    fractions alone confirm.
    """
    for name in ("FAULT", "CONSISTENT"):
        c = res.explain(int(np.argmax(res.status == jb.Status[name])))
        assert c.proves.name == name
        check_certificate.confirm(json.loads(c.to_json()))
