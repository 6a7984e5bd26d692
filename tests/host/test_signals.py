import os
import signal

import pytest

from canopen_control.host.signals import interrupt, on_signals


def test_it_calls_within_the_block_and_is_as_before_afterwards():
    before, called = signal.getsignal(signal.SIGUSR1), []
    with on_signals((signal.SIGUSR1,), lambda: called.append(1)):
        os.kill(os.getpid(), signal.SIGUSR1)
        assert called == [1]
    assert signal.getsignal(signal.SIGUSR1) is before


def test_an_error_in_the_block_restores_too():
    before = signal.getsignal(signal.SIGUSR1)
    with pytest.raises(ZeroDivisionError), on_signals((signal.SIGUSR1,), list):
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGUSR1) is before


def test_a_signal_can_end_as_ctrl_c_does():
    with pytest.raises(KeyboardInterrupt), on_signals((signal.SIGUSR1,), interrupt):
        os.kill(os.getpid(), signal.SIGUSR1)
