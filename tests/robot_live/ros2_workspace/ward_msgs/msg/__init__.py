"""A list of tag readings as no ROS distribution has it, made without colcon and a compiler. For tests of raw bytes alone.

A generated package gives rclpy a C structure that names the type and knows how to write it. Raw bytes need no writing, so a
copy of std_msgs/String's structure with another name and another hash is a type of its own on the wire.
"""

import ctypes
import os

from std_msgs.msg import String

HASH = os.environ.get("WARD_MSGS_HASH", "")
"""REP 2011's hash that publishers announce, as 64 hexadecimal digits."""

_HANDLE_WORDS, _CALLBACK_WORDS = 6, 7
_DATA, _FUNCTION, _HASH_FUNCTION = 1, 2, 3
_word = ctypes.c_void_p
_kept = []
"""What C points to, which must stay as long as the process."""


def _copied_words(address, count):
    words = (_word * count).from_buffer_copy(ctypes.string_at(address, count * ctypes.sizeof(_word)))
    _kept.append(words)
    return words


def _text(value):
    buffer = ctypes.create_string_buffer(value.encode())
    _kept.append(buffer)
    return ctypes.addressof(buffer)


def _type_support(name):
    """Return a capsule with the copied structure, for the middleware that the wheels have: Fast DDS."""
    library = ctypes.CDLL("libstd_msgs__rosidl_typesupport_fastrtps_c.so")
    get_handle = library.rosidl_typesupport_fastrtps_c__get_message_type_support_handle__std_msgs__msg__String
    get_handle.restype = _word
    handle = _copied_words(get_handle(), _HANDLE_WORDS)
    callbacks = _copied_words(handle[_DATA], _CALLBACK_WORDS)
    callbacks[0], callbacks[1] = _text("ward_msgs::msg"), _text(name)
    handle[_DATA] = ctypes.addressof(callbacks)
    if HASH:
        value = ctypes.create_string_buffer(b"\x01" + bytes.fromhex(HASH))
        tell = ctypes.CFUNCTYPE(_word, _word)(lambda _: ctypes.addressof(value))
        _kept.extend([value, tell])
        handle[_HASH_FUNCTION] = ctypes.cast(tell, _word).value
    new = ctypes.pythonapi.PyCapsule_New
    new.restype, new.argtypes = ctypes.py_object, [_word, ctypes.c_char_p, _word]
    return new(ctypes.addressof(handle), None, None)


def _metaclass(name):
    """Return a metaclass of the one type, in which rclpy looks for everything, as in those that are generated."""

    class Generated(type):
        _TYPE_SUPPORT = None

        @classmethod
        def __import_type_support__(cls):
            if String._TYPE_SUPPORT is None:
                String.__import_type_support__()
            for function in ("_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE"):
                setattr(cls, function, getattr(String, function))
            cls._TYPE_SUPPORT = _type_support(name)

    return Generated


class Tag(metaclass=_metaclass("Tag")):
    @classmethod
    def get_fields_and_field_types(cls):
        return {
            "epc": "string",
            "antenna": "uint8",
            "rssi_dbm": "float",
            "range_mm": "uint16",
            "seen": "builtin_interfaces/Time",
        }


class TagArray(metaclass=_metaclass("TagArray")):
    @classmethod
    def get_fields_and_field_types(cls):
        return {"header": "std_msgs/Header", "tags": "sequence<ward_msgs/Tag>"}
