"""The inspector: why each triangle near the tool gave a plane, or was passed over.

`InspectorTab` is the door, a part of the page. It reads the tick that the page shows; what takes
longer than a frame is worked out on a thread of its own, with an arm of its own.
"""

from app.view.inspector.tab import InspectorTab

__all__ = ["InspectorTab"]
