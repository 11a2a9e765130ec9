"""Admission to the control socket: places, the share of a user, and who leaves the waiting room."""

from piezod.daemon.admission import MAX_CLIENTS, MAX_PER_USER, MAX_WAITING, Admission

ALICE, BOB = 1000, 1001


def filled(*users):
    admission = Admission()
    return admission, [admission.admit(k, uid)[0] for k, uid in enumerate(users)]


def test_one_user_leaves_places_for_the_others():
    admission, places = filled(*[ALICE] * MAX_CLIENTS)
    assert sum(place.served for place in places) == MAX_PER_USER
    assert admission.admit("bob", BOB)[0].served


def test_a_client_in_the_waiting_room_may_stop_and_disarm_and_then_ask_for_the_status():
    admission, _ = filled(*[ALICE] * MAX_PER_USER)
    place, leaves = admission.admit("late", ALICE)
    assert leaves is None
    assert [place.may_send(one) for one in ("stop", "disarm", "arm", "status", "reset")] == [1, 1, 0, 0, 0]
    place.commanded = True
    assert [place.may_send(one) for one in ("stop", "arm", "status")] == [1, 0, 1]


def test_the_longest_waiting_client_of_the_user_with_most_clients_leaves_the_full_waiting_room():
    admission, _ = filled(*[ALICE] * MAX_PER_USER, *[BOB] * (MAX_CLIENTS - MAX_PER_USER))
    bob = admission.admit("bob", BOB)[0]
    waiting = [admission.admit(f"alice {k}", ALICE)[0] for k in range(MAX_WAITING - 1)]
    waiting[0].commanded = True
    assert admission.admit("another", ALICE)[1] is waiting[1]
    assert admission.admit("another", BOB)[1] is waiting[2]
    assert not bob.served


def test_a_place_that_is_left_is_given_to_the_next_client():
    admission, places = filled(*[ALICE] * MAX_PER_USER)
    assert not admission.admit("refused", ALICE)[0].served
    admission.leave(places[3])
    admission.leave(places[3])
    assert admission.admit("served", ALICE)[0].served
