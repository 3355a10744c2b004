from .body import Body, ElasticBody
from .build import elastic_body
from .part import NODE_CHOICES, Part, make_part
from .vtkhdf import VTK_VERTEX, Cells

__all__ = ["NODE_CHOICES", "VTK_VERTEX", "Body", "Cells", "ElasticBody", "Part", "elastic_body", "make_part"]
