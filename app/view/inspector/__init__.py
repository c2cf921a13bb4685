"""The inspector: why each triangle near the tool gave a plane, or gave none.

`InspectorTab` is the part of the page. It inspects the tick that the page shows; what takes longer
than a frame is computed on a thread of its own, with its own copy of the arm.
"""

from app.view.inspector.tab import InspectorTab

__all__ = ["InspectorTab"]
