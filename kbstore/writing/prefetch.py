"""Reading at once the timelines that many updates will touch."""

from collections import defaultdict

from kbstore.messages import Condition, Fact, Function, Instance, KnowledgeItem, KnowledgeType
from kbstore.model.timelines import Role
from kbstore.names import key
from kbstore.writing.change_set import ChangeSet


class Prefetch:
    """The timelines that updates will touch, as far as that can be told beforehand; read at once."""

    def __init__(self) -> None:
        self._atoms: dict[tuple[Role, KnowledgeType], dict[str, tuple[str, ...]]] = defaultdict(dict)
        self._objects: set[str] = set()

    def note(self, role: Role, item: KnowledgeItem | Condition) -> None:
        """Note what an item will touch."""
        if isinstance(item, Fact | Function):
            keys = item.key
            self._atoms[role, item.knowledge_type][" ".join(keys)] = keys
        elif isinstance(item, Instance):
            self._objects.add(key(item.instance_name))

    def load(self, draft: ChangeSet) -> None:
        """Read it."""
        for (role, kind), atoms in self._atoms.items():
            draft.load(role, kind, atoms)
            tracks = draft.group(role, kind)
            for name, keys in atoms.items():
                track = tracks.get(name)
                # what stands speaks of objects that exist
                if track is None or track.value is None:
                    self._objects.update(keys[1:])
        draft.load(Role.STATE, KnowledgeType.INSTANCE, self._objects)
