"""KnowledgeItems as clients of ROSPlan make them, for any implementation of the messages."""


class Items:
    """Makes KnowledgeItems by `make`, which makes a message of a type."""

    def __init__(self, make):
        self.make = make

    def item(self, kind, **values):
        found = self.make("KnowledgeItem")
        found.knowledge_type = kind
        for name, value in values.items():
            setattr(found, name, value)
        return found

    def instance(self, name, type_name):
        return self.item(0, instance_name=name, instance_type=type_name)

    def fact(self, name, values=(), **fields):
        """A fact; `values` are pairs of a label and an object."""
        return self.item(1, attribute_name=name, values=self.labelled(values), **fields)

    def function(self, name, values, value, op=0):
        return self.item(2, attribute_name=name, values=self.labelled(values), function_value=value, assign_op=op)

    def metric(self, optimization, name, values):
        found = self.item(3, optimization=optimization)
        found.expr.tokens = [self.token(1, function=(name, values))]
        return found

    def comparison(self, kind, name, values, number):
        """``(> (name values) number)``, of the kind of comparison."""
        found = self.item(4)
        found.ineq.comparison_type = kind
        found.ineq.grounded = True
        found.ineq.LHS.tokens = [self.token(1, function=(name, values))]
        found.ineq.RHS.tokens = [self.token(0, constant=number)]
        return found

    def token(self, kind, *, function=None, constant=0.0):
        found = self.make("ExprBase")
        found.expr_type, found.constant = kind, constant
        if function is not None:
            found.function.name = function[0]
            found.function.typed_parameters = self.labelled(function[1])
        return found

    def labelled(self, pairs):
        found = []
        for label, name in pairs:
            value = self.make("KeyValue")
            value.key, value.value = label, name
            found.append(value)
        return found


def values(item):
    """The labelled values of an item or formula as pairs."""
    found = item.values if hasattr(item, "values") else item.typed_parameters
    return [(value.key, value.value) for value in found]
