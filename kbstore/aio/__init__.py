"""kbstore for asyncio: the same names, awaited.

>>> import asyncio
>>> async def main():
...     async with open("sqlite://") as kb:
...         await kb.add("(raining)")
...         return await kb.holds("(raining)")
>>> asyncio.run(main())
True
"""

from kbstore.aio.knowledge_base import KnowledgeBase, open
from kbstore.aio.transaction import OpenTransaction
from kbstore.aio.watching import Watch

__all__ = ["KnowledgeBase", "OpenTransaction", "Watch", "open"]
