// Threads that wait for work, beside the one that has it.
#pragma once

#include <condition_variable>
#include <functional>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

class Crew {
 public:
  // threads: with the one that calls run().
  explicit Crew(int threads) {
    for (int i = 1; i < threads; ++i) {
      try {
        others_.emplace_back([this] { wait_for_work(); });
      } catch (const std::system_error&) {
        break;  // no more threads to be had: fewer do the same work
      }
    }
  }
  ~Crew() {
    hand_out(nullptr);
    for (std::thread& other : others_) other.join();
  }

  // Every thread calls `work` once; returns when all have.
  void run(const std::function<void()>& work) {
    hand_out(&work);
    work();
    std::unique_lock<std::mutex> lock(mutex_);
    done_.wait(lock, [this] { return busy_ == 0; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable begun_, done_;
  const std::function<void()>* work_ = nullptr;  // null: go home
  size_t busy_ = 0;
  uint64_t round_ = 0;
  std::vector<std::thread> others_;

  void hand_out(const std::function<void()>* work) {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      work_ = work;
      busy_ = others_.size();
      ++round_;
    }
    begun_.notify_all();
  }

  void wait_for_work() {
    uint64_t seen = 0;
    for (;;) {
      std::unique_lock<std::mutex> lock(mutex_);
      begun_.wait(lock, [&] { return round_ != seen; });
      seen = round_;
      const std::function<void()>* work = work_;
      if (!work) return;
      lock.unlock();
      (*work)();
      lock.lock();
      if (--busy_ == 0) done_.notify_one();
    }
  }
};
