from .body import Body, ElasticBody
from .build import elastic_body
from .part import NODE_CHOICES, Part, make_part
from .vtkhdf import VTK_VERTEX, CellBlock

__all__ = ["NODE_CHOICES", "VTK_VERTEX", "Body", "CellBlock", "ElasticBody", "Part", "elastic_body", "make_part"]
