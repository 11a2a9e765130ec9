"""Admission of clients to the control socket: who is served, and who must leave for another.

A served client may send every command. When the places are taken, a further client is admitted to the waiting room.
There it may send only `stop` and `disarm`, and the status after them. When the waiting room is full too, the client
that has waited longest without a command leaves. So clients that are merely connected never keep out a stop.
"""

from dataclasses import dataclass
from itertools import count
from typing import Generic, TypeVar

MAX_CLIENTS = 16  # clients that are served at the same time
MAX_PER_USER = 12  # clients of one user that are served at the same time
MAX_WAITING = 64  # clients in the waiting room at the same time
URGENT = ("stop", "disarm")  # commands that are obeyed in the waiting room
ClientT = TypeVar("ClientT")


@dataclass
class Place(Generic[ClientT]):
    """The place of one client.

    Parameters
    ----------
    served
        Whether it may send every command; otherwise it is in the waiting room.
    number
        Number of its admission; a lower one is earlier.
    commanded
        Whether it has sent an urgent command in the waiting room; it then may also ask for the status.
    """

    client: ClientT
    uid: int
    served: bool
    number: int
    commanded: bool = False

    def may_send(self, command: str) -> bool:
        """Whether a command is obeyed at this place."""
        return self.served or command in URGENT or (self.commanded and command == "status")


class Admission(Generic[ClientT]):
    """The places of all clients of a control socket."""

    def __init__(self) -> None:
        self._served: list[Place[ClientT]] = []
        self._waiting: list[Place[ClientT]] = []
        self._numbers = count()

    def admit(self, client: ClientT, uid: int) -> tuple[Place[ClientT], Place[ClientT] | None]:
        """Give a place to a client.

        Returns
        -------
        tuple
            Its place, and the place of a client that must be disconnected for it; None: nobody.
        """
        of_user = sum(place.uid == uid for place in self._served)
        served = len(self._served) < MAX_CLIENTS and of_user < MAX_PER_USER
        place = Place(client, uid, served, next(self._numbers))
        if served:
            self._served.append(place)
            return place, None
        disconnected = self._longest_waiting() if len(self._waiting) >= MAX_WAITING else None
        if disconnected is not None:
            self._waiting.remove(disconnected)
        self._waiting.append(place)
        return place, disconnected

    def _longest_waiting(self) -> Place[ClientT]:
        """Place of the waiting client that leaves first: without a command, of the user with most clients, earliest."""
        per_user: dict[int, int] = {}
        for place in self._waiting:
            per_user[place.uid] = per_user.get(place.uid, 0) + 1
        return min(self._waiting, key=lambda place: (place.commanded, -per_user[place.uid], place.number))

    def leave(self, place: Place[ClientT]) -> None:
        """Free a place; no effect if it is free already."""
        for places in (self._served, self._waiting):
            if place in places:
                places.remove(place)
