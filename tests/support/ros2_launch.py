"""A small stand-in for `launch`, `launch_ros` and `moveit_configs_utils`: it starts nothing.

`started` evaluates a launch file of an exported workspace, with those it includes, and returns the
processes that it would start. Classes accept only the keywords of the real ones.
"""

from __future__ import annotations

import runpy
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import yaml


class Process(NamedTuple):
    """A process of a launch file; `words` are its arguments."""

    package: str
    executable: str
    words: tuple[str, ...]
    parameters: tuple[Any, ...] = ()


class _Context(NamedTuple):
    workspace: Path
    values: dict[str, str]


class _Substitution:
    def __init__(self, *parts: Any) -> None:
        self.parts = parts

    def value(self, context: _Context) -> str:
        raise NotImplementedError


def _text(thing: Any, context: _Context) -> str:
    if isinstance(thing, str):
        return thing
    if isinstance(thing, _Substitution):
        return thing.value(context)
    assert isinstance(thing, (list, tuple)), f"no substitution: {thing!r}"
    return "".join(_text(part, context) for part in thing)


class LaunchConfiguration(_Substitution):
    def value(self, context: _Context) -> str:
        (name,) = self.parts
        assert name in context.values, f"launch argument '{name}' is not declared"
        return context.values[name]


class PathJoinSubstitution(_Substitution):
    def value(self, context: _Context) -> str:
        (parts,) = self.parts
        return "/".join(_text(part, context) for part in parts)


class PythonExpression(_Substitution):
    def value(self, context: _Context) -> str:
        (parts,) = self.parts
        return str(eval(_text(parts, context)))


class Command(_Substitution):
    def value(self, context: _Context) -> str:
        (parts,) = self.parts
        return f"$({_text(parts, context)})"


class FindExecutable(_Substitution):
    def __init__(self, *, name: str) -> None:
        super().__init__(name)

    def value(self, context: _Context) -> str:
        return self.parts[0]


class FindPackageShare(_Substitution):
    def value(self, context: _Context) -> str:
        (package,) = self.parts
        own = context.workspace / "src" / package
        return str(own) if own.is_dir() else f"/opt/ros/share/{package}"


class ParameterValue(_Substitution):
    def __init__(self, value: Any, *, value_type: type | None = None) -> None:
        super().__init__(value)
        self.value_type = value_type

    def value(self, context: _Context) -> str:
        return _text(self.parts[0], context)


class IfCondition:
    wanted = ("true", "1")

    def __init__(self, predicate: Any) -> None:
        self.predicate = predicate

    def holds(self, context: _Context) -> bool:
        word = _text(self.predicate, context).lower()
        assert word in ("true", "false", "1", "0"), f"a condition is '{word}'"
        return word in self.wanted


class UnlessCondition(IfCondition):
    wanted = ("false", "0")


class DeclareLaunchArgument:
    def __init__(
        self,
        name: str,
        *,
        default_value: Any = None,
        description: str | None = None,
        choices: list[str] | None = None,
    ) -> None:
        self.name = name
        self.default_value = default_value
        self.choices = choices


class Node:
    def __init__(
        self,
        *,
        package: str,
        executable: str,
        name: str | None = None,
        namespace: str | None = None,
        parameters: list[Any] | None = None,
        remappings: list[tuple[str, str]] | None = None,
        arguments: list[Any] | None = None,
        output: str = "log",
        condition: IfCondition | None = None,
    ) -> None:
        self.package = package
        self.executable = executable
        self.parameters = parameters or []
        self.arguments = arguments or []
        self.condition = condition


class ExecuteProcess:
    def __init__(
        self,
        *,
        cmd: list[Any],
        output: str = "log",
        condition: IfCondition | None = None,
    ) -> None:
        self.cmd = cmd
        self.condition = condition


class PythonLaunchDescriptionSource:
    def __init__(self, path: Any) -> None:
        self.path = path


class IncludeLaunchDescription:
    def __init__(
        self,
        source: PythonLaunchDescriptionSource,
        *,
        launch_arguments: Any = (),
        condition: IfCondition | None = None,
    ) -> None:
        self.source = source
        self.launch_arguments = dict(launch_arguments)
        self.condition = condition


class OnProcessExit:
    def __init__(self, *, target_action: Any, on_exit: list[Any]) -> None:
        self.target_action = target_action
        self.on_exit = on_exit


class RegisterEventHandler:
    condition = None

    def __init__(self, handler: OnProcessExit) -> None:
        self.handler = handler


class LaunchDescription:
    def __init__(self, entities: list[Any]) -> None:
        self.entities = entities


class MoveItConfigs:
    """What the builder read: {name: document}."""

    def __init__(self, package_path: Path, documents: dict[str, Any]) -> None:
        self.package_path = package_path
        self.documents = documents

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return {name: self.documents[name]}

    def to_dict(self) -> dict[str, Any]:
        return dict(self.documents)


class MoveItConfigsBuilder:
    """Reads the files that the launch file names; one that is not there is an error."""

    workspace: Path

    def __init__(self, robot_name: str, *, package_name: str) -> None:
        self._folder = self.workspace / "src" / package_name
        self._documents: dict[str, Any] = {}

    def _read(self, name: str, file_path: str) -> MoveItConfigsBuilder:
        text = (self._folder / file_path).read_text(encoding="utf-8")
        is_yaml = file_path.endswith(".yaml")
        self._documents[name] = yaml.safe_load(text) if is_yaml else text
        return self

    def robot_description(
        self,
        *,
        file_path: str,
        mappings: dict[str, str] | None = None,
    ) -> MoveItConfigsBuilder:
        return self._read("robot_description", file_path)

    def robot_description_semantic(self, *, file_path: str) -> MoveItConfigsBuilder:
        return self._read("robot_description_semantic", file_path)

    def robot_description_kinematics(self, *, file_path: str) -> MoveItConfigsBuilder:
        return self._read("robot_description_kinematics", file_path)

    def joint_limits(self, *, file_path: str) -> MoveItConfigsBuilder:
        return self._read("joint_limits", file_path)

    def pilz_cartesian_limits(self, *, file_path: str) -> MoveItConfigsBuilder:
        return self._read("pilz_cartesian_limits", file_path)

    def trajectory_execution(self, *, file_path: str) -> MoveItConfigsBuilder:
        return self._read("trajectory_execution", file_path)

    def planning_pipelines(self, *, pipelines: list[str]) -> MoveItConfigsBuilder:
        self._documents["planning_pipelines"] = pipelines
        for pipeline in pipelines:
            self._read(f"{pipeline}_planning", f"config/{pipeline}_planning.yaml")
        return self

    def to_moveit_configs(self) -> MoveItConfigs:
        return MoveItConfigs(self._folder, self._documents)


_MODULES: dict[str, tuple[type, ...]] = {
    "launch": (LaunchDescription,),
    "launch.actions": (
        DeclareLaunchArgument,
        ExecuteProcess,
        IncludeLaunchDescription,
        RegisterEventHandler,
    ),
    "launch.conditions": (IfCondition, UnlessCondition),
    "launch.event_handlers": (OnProcessExit,),
    "launch.launch_description_sources": (PythonLaunchDescriptionSource,),
    "launch.substitutions": (
        Command,
        FindExecutable,
        LaunchConfiguration,
        PathJoinSubstitution,
        PythonExpression,
    ),
    "launch_ros": (),
    "launch_ros.actions": (Node,),
    "launch_ros.parameter_descriptions": (ParameterValue,),
    "launch_ros.substitutions": (FindPackageShare,),
    "moveit_configs_utils": (MoveItConfigsBuilder,),
}


def started(workspace: Path, package: str, file: str, **arguments: str) -> list[Process]:
    """Return the processes that `ros2 launch PACKAGE FILE NAME:=VALUE ...` would start."""
    saved = {name: sys.modules.get(name) for name in _MODULES}
    for name, members in _MODULES.items():
        module = types.ModuleType(name)
        for member in members:
            setattr(module, member.__name__, member)
        sys.modules[name] = module
    MoveItConfigsBuilder.workspace = workspace
    try:
        path = workspace / "src" / package / "launch" / file
        return list(_processes(path, workspace, arguments))
    finally:
        for name, module in saved.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


def _processes(path: Path, workspace: Path, given: dict[str, str]) -> Iterator[Process]:
    description = runpy.run_path(str(path))["generate_launch_description"]()
    context = _Context(workspace, {})
    for entity in description.entities:
        if isinstance(entity, DeclareLaunchArgument):
            default = _text(entity.default_value, context)
            value = given.get(entity.name, default)
            if entity.choices is not None:
                assert value in entity.choices, f"{entity.name}:={value} is not in {entity.choices}"
            context.values[entity.name] = value
    unknown = sorted(set(given) - set(context.values))
    assert not unknown, f"{path.name} declares no argument {', '.join(unknown)}"
    yield from _of_entities(description.entities, context)


def _of_entities(entities: list[Any], context: _Context) -> Iterator[Process]:
    for entity in entities:
        if isinstance(entity, DeclareLaunchArgument):
            continue
        if entity.condition is not None and not entity.condition.holds(context):
            continue
        if isinstance(entity, Node):
            words = tuple(_text(word, context) for word in entity.arguments)
            parameters = tuple(_parameter(item, context) for item in entity.parameters)
            yield Process(entity.package, entity.executable, words, parameters)
        elif isinstance(entity, ExecuteProcess):
            program, *words = (_text(word, context) for word in entity.cmd)
            yield Process("", program, tuple(words))
        elif isinstance(entity, RegisterEventHandler):
            yield from _of_entities(entity.handler.on_exit, context)
        else:
            assert isinstance(entity, IncludeLaunchDescription), entity
            path = Path(_text(entity.source.path, context))
            given = {name: _text(value, context) for name, value in entity.launch_arguments.items()}
            if path.is_relative_to("/opt/ros"):
                yield Process(path.parts[4], path.name, tuple(given.values()))
            else:
                yield from _processes(path, context.workspace, given)


def _parameter(item: Any, context: _Context) -> Any:
    """Return a parameter file's path, which must exist, or the parameters with their values."""
    if not isinstance(item, dict):
        path = Path(_text(item, context))
        assert path.is_file(), f"no parameter file {path}"
        return path
    return {
        name: value.value(context) if isinstance(value, _Substitution) else value
        for name, value in item.items()
    }
