from .body import NODE_CHOICES, VTK_VERTEX, Cells, ElasticBody, Part, elastic_body, make_part

__all__ = ["NODE_CHOICES", "VTK_VERTEX", "Cells", "ElasticBody", "Part", "elastic_body", "make_part"]
