"""The deadline: processor time of one thread and of the compilers that it waited for, the same for every loop."""

import subprocess
import sys
import threading
import time

import pytest

from linkplan.models.deadline import NO_DEADLINE, Deadline, OutOfTimeError, processor_time_s, waiting_for_child
from linkplan.models.errors import LinkplanError


def work(seconds: float) -> None:
    """Use so much processor time of this thread."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        sum(range(1000))


def counting() -> Deadline:
    """Return a deadline whose clock goes on by one second each time that it is read."""
    reads = iter(range(1_000_000))
    return Deadline(clock=lambda: float(next(reads)))


def test_without_a_deadline_there_is_always_time():
    NO_DEADLINE.require_time()
    assert not NO_DEADLINE.passed
    assert NO_DEADLINE.within_share(0.5) == NO_DEADLINE


def test_a_loop_without_an_answer_ends_in_one_error_of_ours():
    late = Deadline().within(-1.0)
    assert late.passed
    assert late.left_s < 0
    with pytest.raises(OutOfTimeError):
        late.require_time()
    assert issubclass(OutOfTimeError, LinkplanError)


def test_the_earlier_of_two_deadlines_holds():
    soon = Deadline(clock=lambda: 10.0).within(5.0)
    assert soon.at_s == 15.0
    assert soon.within(9.0).at_s == 15.0
    assert soon.within(2.0).at_s == 12.0
    assert soon.within_share(0.2).at_s == 11.0
    assert soon.later_by(3.0).at_s == 18.0


def test_items_end_with_the_time_also_while_one_is_made():
    def made(deadline):
        for item in range(100):
            deadline.require_time()
            yield item

    between = counting().within(5.0)
    assert 1 < len(list(between.take(range(100)))) < 10
    while_made = counting().within(5.0)
    assert 1 < len(list(while_made.take(made(while_made)))) < 10


def test_threads_do_not_share_their_time():
    begin = processor_time_s()
    other = threading.Thread(target=work, args=(0.3,))
    other.start()
    other.join()
    assert processor_time_s() - begin < 0.2


def test_a_child_that_is_waited_for_counts_in_the_thread_that_waits():
    spin = "import time\nwhile time.process_time() < 0.4: pass"  # a child's time is known to some hundredths of a second
    begin, own, of_another = processor_time_s(), time.thread_time(), []
    with waiting_for_child():
        subprocess.run([sys.executable, "-c", spin], check=True)
    other = threading.Thread(target=lambda: of_another.append(processor_time_s() - time.thread_time()))
    other.start()
    other.join()
    assert processor_time_s() - begin - (time.thread_time() - own) >= 0.3
    assert of_another[0] < 0.01


def test_the_whole_wait_for_a_child_that_hangs_counts():
    begin = processor_time_s()
    with pytest.raises(subprocess.TimeoutExpired), waiting_for_child():
        subprocess.run([sys.executable, "-c", "import time; time.sleep(60)"], check=True, timeout=0.3)
    assert processor_time_s() - begin >= 0.3
