from .body import NODE_CHOICES, ElasticBody, Part, elastic_body, make_part
from .vtkhdf import VTK_VERTEX, Cells

__all__ = ["NODE_CHOICES", "VTK_VERTEX", "Cells", "ElasticBody", "Part", "elastic_body", "make_part"]
