import threading

from app.control.mailbox import Mailbox


def test_the_newest_value_wins_and_stays() -> None:
    box: Mailbox[int] = Mailbox()
    assert box.get() is None
    box.put(1)
    box.put(2)
    assert box.get() == 2
    assert box.get() == 2


def test_a_reader_sees_whole_values_in_order() -> None:
    # The writer puts pairs (k, k); a reader must never see a mixed or an older one.
    box: Mailbox[tuple[int, int]] = Mailbox((0, 0))
    last = 20_000

    def write() -> None:
        for k in range(last + 1):
            box.put((k, k))

    writer = threading.Thread(target=write)
    writer.start()
    newest = 0
    while newest < last:
        value = box.get()
        assert value is not None
        assert value[0] == value[1] >= newest
        newest = value[0]
    writer.join()
