// Stand-in for the part of rclcpp that the exported node uses; written for the tests of surctl. Names, arguments and types are those
// of rclcpp's public headers. Time is virtual, and rclcpp::spin reads a script from stdin, one command a line:
//   TOPIC number...          a message arrives (its numbers in the order of `>>` in messages.hpp)
//   time SECONDS             the clock moves on, and the timer fires once for each period
//   late SECONDS             the clock moves on, and the timer fires once
//   set NAME number...       a parameter is set; prints `set NAME 1` or `set NAME 0 reason`
// Published messages are printed as `TOPIC number...`.
#pragma once

#include <chrono>
#include <cstdarg>
#include <cstdio>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "messages.hpp"

namespace rclcpp
{

class Time
{
public:
  explicit Time(double seconds = 0.0) : seconds_(seconds) {}
  double seconds() const {return seconds_;}
  operator builtin_interfaces::msg::Time() const
  {
    builtin_interfaces::msg::Time stamp;
    stamp.sec = static_cast<std::int32_t>(seconds_);
    stamp.nanosec = static_cast<std::uint32_t>(1e9 * (seconds_ - stamp.sec));
    return stamp;
  }

private:
  double seconds_;
};

class Duration
{
public:
  explicit Duration(std::chrono::nanoseconds nanoseconds) : nanoseconds_(nanoseconds) {}
  double seconds() const {return 1e-9 * static_cast<double>(nanoseconds_.count());}

private:
  std::chrono::nanoseconds nanoseconds_;
};

class Clock
{
public:
  using SharedPtr = std::shared_ptr<Clock>;
  Time now() const {return Time(seconds);}
  double seconds = 100.0;
};

class QoS
{
public:
  explicit QoS(std::size_t depth) : depth_(depth) {}
  QoS & reliable() {return *this;}
  std::size_t depth_;
};
class SensorDataQoS : public QoS
{
public:
  SensorDataQoS() : QoS(5) {}
};

class NodeOptions {};
class Logger {};

#define RCLCPP_ERROR_THROTTLE(logger, clock, duration, ...) \
  do {(void)(logger); (void)(clock).now(); (void)(duration); std::fprintf(stderr, __VA_ARGS__);} while (0)

class TimerBase
{
public:
  using SharedPtr = std::shared_ptr<TimerBase>;
  double period = 0.0;
  std::function<void()> callback;
};

class SubscriptionBase {};
template<typename MessageT>
class Subscription : public SubscriptionBase
{
public:
  using SharedPtr = std::shared_ptr<Subscription<MessageT>>;
};

template<typename MessageT>
class Publisher
{
public:
  using SharedPtr = std::shared_ptr<Publisher<MessageT>>;
  explicit Publisher(std::string topic) : topic_(std::move(topic)) {}
  void publish(const MessageT & message) {std::cout << topic_ << ' ' << message << '\n';}

private:
  std::string topic_;
};

class Parameter
{
public:
  Parameter(std::string name, std::vector<double> numbers) : name_(std::move(name)), numbers_(std::move(numbers)) {}
  const std::string & get_name() const {return name_;}
  double as_double() const {return numbers_.at(0);}
  std::string as_string() const {return "text";}
  std::vector<double> as_double_array() const {return numbers_;}

private:
  std::string name_;
  std::vector<double> numbers_;
};

namespace node_interfaces
{
class OnSetParametersCallbackHandle
{
public:
  using SharedPtr = std::shared_ptr<OnSetParametersCallbackHandle>;
  std::function<rcl_interfaces::msg::SetParametersResult(const std::vector<Parameter> &)> callback;
};
}  // namespace node_interfaces

class Node
{
public:
  Node(const std::string & name, const NodeOptions &) : name_("/" + name) {}
  virtual ~Node() = default;

  const char * get_fully_qualified_name() const {return name_.c_str();}
  Logger get_logger() const {return Logger();}
  Clock::SharedPtr get_clock() {return clock_;}

  template<typename T>
  T declare_parameter(
    const std::string & name, const T & value,
    const rcl_interfaces::msg::ParameterDescriptor & descriptor = rcl_interfaces::msg::ParameterDescriptor())
  {
    std::cout << "declared " << name << ' ' << descriptor.floating_point_range.size();
    for (const auto & range : descriptor.floating_point_range) {
      std::cout << ' ' << range.from_value << ' ' << range.to_value;
    }
    std::cout << " | " << descriptor.description << '\n';
    return value;
  }

  template<typename CallbackT>
  node_interfaces::OnSetParametersCallbackHandle::SharedPtr add_on_set_parameters_callback(CallbackT && callback)
  {
    on_set_ = std::make_shared<node_interfaces::OnSetParametersCallbackHandle>();
    on_set_->callback = std::forward<CallbackT>(callback);
    return on_set_;
  }

  template<typename MessageT, typename CallbackT>
  std::shared_ptr<Subscription<MessageT>> create_subscription(
    const std::string & topic, const QoS &, CallbackT && callback)
  {
    const std::function<void(std::shared_ptr<const MessageT>)> given = std::forward<CallbackT>(callback);
    topics_[topic] = [given](std::istream & numbers) {
        auto message = std::make_shared<MessageT>();
        numbers >> *message;
        given(message);
      };
    return std::make_shared<Subscription<MessageT>>();
  }

  template<typename MessageT>
  std::shared_ptr<Publisher<MessageT>> create_publisher(const std::string & topic, const QoS &)
  {
    return std::make_shared<Publisher<MessageT>>(topic);
  }

  void stub_run(std::istream & script)
  {
    for (std::string line; std::getline(script, line); ) {
      std::istringstream words(line);
      std::string word;
      words >> word;
      if (word == "time" || word == "late") {
        double seconds = 0.0;
        words >> seconds;
        advance(seconds, word == "late");
      } else if (word == "set") {
        set(words);
      } else {
        topics_.at(word)(words);
      }
    }
  }

  TimerBase::SharedPtr stub_timer;

private:
  void advance(double seconds, bool once)
  {
    const double end = clock_->seconds + seconds;
    while (!once && clock_->seconds + stub_timer->period <= end + 1e-9) {
      clock_->seconds += stub_timer->period;
      stub_timer->callback();
    }
    clock_->seconds = end;
    if (once) {stub_timer->callback();}
  }

  void set(std::istream & words)
  {
    std::string name;
    std::vector<double> numbers;
    words >> name;
    for (double number; words >> number; ) {numbers.push_back(number);}
    const auto result = on_set_->callback({Parameter(name, numbers)});
    std::cout << "set " << name << ' ' << result.successful << ' ' << result.reason << '\n';
  }

  std::string name_;
  Clock::SharedPtr clock_ = std::make_shared<Clock>();
  node_interfaces::OnSetParametersCallbackHandle::SharedPtr on_set_;
  std::map<std::string, std::function<void(std::istream &)>> topics_;
};

template<typename NodeT, typename CallbackT>
TimerBase::SharedPtr create_timer(NodeT node, Clock::SharedPtr, Duration period, CallbackT && callback)
{
  node->stub_timer = std::make_shared<TimerBase>();
  node->stub_timer->period = period.seconds();
  node->stub_timer->callback = std::forward<CallbackT>(callback);
  return node->stub_timer;
}

inline void init(int, char **) {std::cout.precision(17);}
inline void spin(std::shared_ptr<Node> node) {node->stub_run(std::cin);}
inline bool shutdown() {return true;}

}  // namespace rclcpp
