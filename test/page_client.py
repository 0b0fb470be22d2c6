"""A browser of few words: speaks the page's protocol over a websocket, without drawing anything."""

import threading
import time
from typing import Any

import msgspec
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

_COMPLETE_S = 20.0


class PageClient:
    """Looks at a page and presses its buttons."""

    def __init__(self, address: str) -> None:
        #: The panel's elements by id: their properties, and their value as ``value``.
        self.elements: dict[str, dict[str, Any]] = {}
        #: Where things are drawn in the scene, by name.
        self.positions: dict[str, Any] = {}
        self._complete = threading.Event()
        self._socket = connect(
            address.replace("http", "ws", 1),
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            compression=None,
            max_size=None,
        )
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._thread.start()
        # A browser counts from its first camera on.
        self._send(
            type="ViewerCameraMessage",
            wxyz=(1.0, 0.0, 0.0, 0.0),
            position=(3.0, 3.0, 3.0),
            fov=1.0,
            near=0.01,
            far=1000.0,
            image_height=600,
            image_width=800,
            look_at=(0.0, 0.0, 0.0),
            up_direction=(0.0, 0.0, 1.0),
        )
        if not self._complete.wait(_COMPLETE_S):
            raise TimeoutError(f"the page was not complete within {_COMPLETE_S} s")

    def _send(self, **message: Any) -> None:
        self._socket.send(msgspec.msgpack.encode(message))

    def _receive(self) -> None:
        decompressor = zstandard.ZstdDecompressor()
        try:
            for raw in self._socket:
                assert isinstance(raw, bytes)
                size = int.from_bytes(raw[:8], "little")
                end = 16 + int.from_bytes(raw[8:16], "little")
                plain = decompressor.decompress(raw[16:end], max_output_size=size)
                for message in msgspec.msgpack.decode(plain)["messages"]:
                    self._take(message)
        except ConnectionClosed:
            return

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "ReplayDoneMessage":
            self._complete.set()
        if kind == "SetPositionMessage":
            self.positions[message["name"]] = message["position"]
        if kind == "GuiUpdateMessage":
            self.elements.setdefault(message["uuid"], {}).update(message["updates"])
        elif "props" in message and "uuid" in message:
            element = {**message["props"], "value": message.get("value")}
            self.elements[message["uuid"]] = element

    # --- what is seen ---

    def find(self, label: str) -> str:
        """Id of the element with a label."""
        for uuid, element in list(self.elements.items()):
            if element.get("label") == label:
                return uuid
        raise KeyError(f"no {label} on the page")

    def value(self, label: str) -> Any:
        """The value of the element with a label."""
        return self.elements[self.find(label)]["value"]

    def text(self) -> str:
        """All that stands on the panel as HTML."""
        return "\n".join(each.get("content", "") for each in list(self.elements.values()))

    # --- what is done ---

    def press(self, label: str) -> None:
        """Press a button."""
        self.set(label, True)

    def set(self, label: str, value: Any) -> None:
        """Set an element."""
        uuid = self.find(label)
        self.elements[uuid]["value"] = value
        self._send(type="GuiUpdateMessage", uuid=uuid, updates={"value": value})

    def drag(self, node: str, *positions: tuple[float, float, float]) -> None:
        """Drag what the scene has under a name through positions, m, and let it go."""
        self._send(type="TransformControlsDragStartMessage", name=node, owner="")
        for position in positions:
            self._send(
                type="TransformControlsUpdateMessage",
                name=node,
                wxyz=(1.0, 0.0, 0.0, 0.0),
                position=position,
                owner="",
            )
        self._send(type="TransformControlsDragEndMessage", name=node, owner="")

    def click(self, node: str, origin: Any, ray: Any) -> None:
        """Click where a ray meets what the scene has under a name."""
        self._send(
            type="SceneNodeClickMessage",
            name=node,
            instance_index=None,
            ray_origin=tuple(map(float, origin)),
            ray_direction=tuple(map(float, ray)),
            screen_pos=(0.5, 0.5),
            modifier=None,
        )

    def close(self, timeout_s: float = 5.0) -> None:
        """Close the browser's window."""
        end_s = time.monotonic() + timeout_s
        self._socket.close()
        self._thread.join(max(0.0, end_s - time.monotonic()))
